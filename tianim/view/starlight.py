"""Starlight: points as light that adds up, developed like a telescope's picture.

Every star spreads its colour over the four pixels round it; the sum is blurred by a point spread
function (a sharp core and a faint wide wing) and stretched so that the core of a galaxy and its
faintest tail both show, with the colour kept (R. Lupton et al., PASP 116 (2004), DOI 10.1086/382245):

    picture = light f(I) / I,   f(I) = asinh(I / I_faint) / asinh(I_bright / I_faint)

I is the mean of the three colours in a pixel. I_faint and I_bright are fixed over the film, from a few
of its frames, so that nothing flickers. A star shines as its mass, where it has one; a star without mass
as one of mean mass. Limits: stars lie behind all that is solid, and nothing dims them.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tianim.frame import Part, Points
from tianim.lang import f32_1d, f32_2d, f32_3d, ti
from tianim.view.layout import HEIGHT, NEAR, WIDTH, i64_3d, to_screen, to_view

Float = NDArray[np.float32]

STEPS = float(1 << 20)  # steps of the summed light in the light of one mean star
CORE = 0.75  # standard deviation of the sharp part of a star [pixels of 720 rows]
WINGS = ((3.5, 0.38), (14.0, 0.10))  # standard deviation [pixels of 720 rows] and share of the light
BRIGHT = 99.8  # percentile of the lit pixels that is shown white
FAINT = 50.0  # percentile of the lit pixels that is shown as FAINT_SHOWN
FAINT_SHOWN = 0.035
LIT = 5e-4  # share of the brightest pixel from which a pixel is lit
LEAST_CONTRAST = 4.0  # I_bright / I_faint of the dullest film


@dataclass(frozen=True)
class Stars:
    """Places (n, 3) [m], light (n,) in units of a mean star, row of the colour table (n,)."""

    position: Float
    light: Float
    tone: Float


def stars_of(part: Points, tone: Float, opacity: float, mean_mass: float) -> Stars:
    """The stars of a part; `opacity` is a factor on their light, `tone` a row of the colour table each."""
    light = np.full(len(part.position), opacity, np.float32)
    if "mass" in part.data and mean_mass > 0.0:
        mass = np.asarray(part.data["mass"], np.float64)
        light *= np.where(mass > 0.0, mass / mean_mass, 1.0).astype(np.float32)
    good = np.isfinite(part.position).all(axis=1) & np.isfinite(light)
    return Stars(part.position[good].astype(np.float32), light[good], tone[good])


def mean_mass(parts: Iterable[Part]) -> float:
    """Mean mass of the stars of those parts that have one; 0 where none has."""
    masses = [np.asarray(part.data["mass"], np.float64) for part in parts if "mass" in part.data]
    massive = np.concatenate([mass[mass > 0.0] for mass in masses]) if masses else np.zeros(0)
    return float(massive.mean()) if len(massive) else 0.0


@ti.kernel
def gather_light(
    total: i64_3d, camera: f32_1d, position: f32_2d, light: f32_1d, tone: f32_1d, colors: f32_2d
):
    """Add each star to the four pixels round it, by nearness; total (height, width, 3) in STEPS."""
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    for n in range(position.shape[0]):
        v = to_view(camera, position[n, 0], position[n, 1], position[n, 2])
        if v[2] > camera[NEAR]:
            s = to_screen(camera, v)
            x, y = s[0] - 0.5, s[1] - 0.5
            if x > -1.0 and y > -1.0 and x < width and y < height:
                left, top = ti.cast(ti.floor(x), ti.i32), ti.cast(ti.floor(y), ti.i32)
                right_share, low_share = x - left, y - top
                row = ti.cast(tone[n], ti.i32)
                for k in ti.static(range(4)):
                    px, py = left + k % 2, top + k // 2
                    if px >= 0 and py >= 0 and px < width and py < height:
                        share = ti.select(k % 2 == 1, right_share, 1.0 - right_share)
                        share *= ti.select(k // 2 == 1, low_share, 1.0 - low_share)
                        for c in ti.static(range(3)):
                            added = ti.cast(colors[row, c] * light[n] * share * STEPS, ti.i64)
                            ti.atomic_add(total[py, px, c], added)


@ti.kernel
def develop(out: f32_3d, light: f32_3d, background: f32_3d, faint: ti.f32, bright: ti.f32, exposure: ti.f32):
    """The background with the stretched light over it."""
    full = ti.log(bright / faint + ti.sqrt((bright / faint) ** 2 + 1.0))
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        mean = (light[y, x, 0] + light[y, x, 1] + light[y, x, 2]) / 3.0
        q = mean / faint
        gain = exposure * ti.log(q + ti.sqrt(q * q + 1.0)) / (full * ti.max(mean, 1e-20))
        for c in ti.static(range(3)):
            out[y, x, c] = background[y, x, c] + gain * light[y, x, c]


class Starlight:
    """Draws stars behind a picture of one size; `expose` first, with pictures typical of the film."""

    def __init__(self, width: int, height: int, exposure: float) -> None:
        self._total = np.zeros((height, width, 3), np.int64)
        self._out = np.empty((height, width, 3), np.float32)
        self._scale = height / 720.0
        self._exposure = exposure
        self._faint, self._bright = 1.0, LEAST_CONTRAST

    def expose(self, pictures: Sequence[tuple[Sequence[Stars], Float]], colors: Float) -> None:
        """Fix the stretch for the film from typical frames: their stars and cameras."""
        lit = [self._light(stars, camera, colors).mean(axis=2) for stars, camera in pictures]
        values = np.concatenate([light[light > LIT * light.max()] for light in lit] or [np.ones(1)])
        if len(values):
            self._bright = max(float(np.percentile(values, BRIGHT)), 1e-9)
            middle = float(np.percentile(values, FAINT))
            self._faint = _faint_for(middle, self._bright)

    def picture(self, stars: Sequence[Stars], camera: Float, colors: Float, background: Float) -> Float:
        """The background (height, width, 3), linear, with the stars; valid until the next picture."""
        light = self._light(stars, camera, colors)
        develop(self._out, light, background, self._faint, self._bright, self._exposure)
        return self._out

    def _light(self, stars: Sequence[Stars], camera: Float, colors: Float) -> Float:
        """Light of the stars through the point spread function, (height, width, 3)."""
        self._total.fill(0)
        for one in stars:
            if len(one.position):
                gather_light(self._total, camera, one.position, one.light, one.tone, colors)
        light = (self._total * (1.0 / STEPS)).astype(np.float32)
        sharp = gaussian_filter(light, (CORE * self._scale, CORE * self._scale, 0), truncate=3.0)
        sharp *= 1.0 - sum(share for _, share in WINGS)
        for deviation, share in WINGS:
            sharp += share * _wide_blur(light, deviation * self._scale)
        return np.ascontiguousarray(sharp)


def _wide_blur(light: Float, deviation: float) -> Float:
    """A blur of at least several pixels, made on a coarser grid."""
    coarse = max(1, int(deviation / 2))
    height, width = light.shape[0] // coarse * coarse, light.shape[1] // coarse * coarse
    blocks = light[:height, :width].reshape(height // coarse, coarse, width // coarse, coarse, 3)
    small = gaussian_filter(blocks.mean(axis=(1, 3)), (deviation / coarse, deviation / coarse, 0))
    out = np.zeros_like(light)
    out[:height, :width] = _enlarged(_enlarged(small, coarse, 0), coarse, 1)
    return out


def _enlarged(values: Float, factor: int, axis: int) -> Float:
    """Linear interpolation between the middles of blocks, `factor` samples each."""
    count = values.shape[axis]
    place = np.clip((np.arange(count * factor) + 0.5) / factor - 0.5, 0, count - 1)
    below = np.minimum(place.astype(np.int64), max(count - 2, 0))
    above = np.minimum(below + 1, count - 1)
    share = (place - below).astype(np.float32)
    shape = [1, 1, 1]
    shape[axis] = -1
    share = share.reshape(shape)
    return np.take(values, below, axis) * (1 - share) + np.take(values, above, axis) * share


def _faint_for(middle: float, bright: float) -> float:
    """I_faint for which `middle` is shown as FAINT_SHOWN, by bisection in the logarithm."""
    low, high = bright * 1e-6, bright / LEAST_CONTRAST
    for _ in range(40):
        faint = (low * high) ** 0.5
        shown = np.arcsinh(middle / faint) / np.arcsinh(bright / faint)
        low, high = (faint, high) if shown > FAINT_SHOWN else (low, faint)
    return faint
