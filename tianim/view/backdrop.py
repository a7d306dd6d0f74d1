"""Backgrounds and the light that goes with them.

A preset is a whole: sky or ground, the colour and direction of the light, fog, and the colours
that subjects take when nothing else is said. Pictures are linear light, (height, width, 3).
"""

from dataclasses import dataclass, replace
from math import radians

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from tianim.view import layout
from tianim.view.colormap import hex_to_linear, to_linear
from tianim.view.layout import FOCAL, PERSPECTIVE

Float = NDArray[np.float32]
Ramp = tuple[tuple[float, str], ...]
Background = str | tuple[str, str]


@dataclass(frozen=True)
class Preset:
    """One background.

    ramp      colours by height: degrees above the horizon (`sky`), else share of the picture from below
    sun       direction of the light as the camera sees it: right, up, towards the camera
    key, above, below  colours of the light, from the sun, the sky and the ground
    subject   colours of species, or of everything where `by` is None or not there
    body, line  colours of meshes that are not the subject, and of lines
    shafts    of light from above
    shadow, corners  how dark a cast shadow and a corner are, 0: not drawn
    pool      light on the floor round the action, None: the floor has the colour of the background
    """

    ramp: Ramp
    sun: tuple[float, float, float]
    key: tuple[float, float, float]
    above: tuple[float, float, float]
    below: tuple[float, float, float]
    subject: tuple[str, ...]
    body: str
    line: str
    sky: bool = False
    shafts: bool = False
    floor: bool = False
    by: str | None = None
    map: str = "viridis"
    fog: float = 0.0
    corners: float = 0.0
    shadow: float = 0.0
    shine: float = 0.15
    rim: float = 0.05
    vignette: float = 0.0
    azimuth: float = 25.0
    elevation: float = 15.0
    darts: str = "darts"
    pool: tuple[float, float, float] | None = None


PRESETS = {
    "dusk": Preset(
        ramp=(
            (-4, "#e9b58f"), (1, "#f7cfa6"), (5, "#f5d0b3"), (11, "#ead0c4"), (19, "#cfc8cf"),
            (30, "#a9b7cc"), (48, "#8aa0bf"), (75, "#6f88ad"),
        ),
        sun=(-0.65, 0.35, -0.68), key=(0.95, 0.62, 0.42), above=(0.36, 0.4, 0.52), below=(0.3, 0.24, 0.22),
        subject=("#191a24", "#8a2f16", "#27446b", "#3f5a2a"), body="#4a4650", line="#2a2a33",
        sky=True, fog=0.22, shine=0.03, rim=0.03, elevation=-15.0, darts="birds",
    ),
    "night": Preset(
        ramp=((0, "#0a0c15"), (0.35, "#10131f"), (0.7, "#0b0d17"), (1, "#06070d")),
        sun=(-0.5, 0.7, 0.5), key=(1.0, 0.97, 0.92), above=(0.30, 0.34, 0.46), below=(0.10, 0.10, 0.14),
        subject=("#e8e4da", "#ff9f5a", "#6cc3ff", "#b6e38a"), body="#4c5160", line="#aab2c5",
        by="speed", map="plasma", fog=0.55, corners=0.6, shine=0.12, rim=0.12, vignette=0.25, elevation=16.0,
    ),
    "space": Preset(
        ramp=((0, "#05060a"), (0.45, "#080a11"), (0.75, "#06070d"), (1, "#030407")),
        sun=(-0.5, 0.7, 0.5), key=(1.0, 0.97, 0.92), above=(0.12, 0.13, 0.18), below=(0.05, 0.05, 0.08),
        subject=("#a9c4ff", "#ffd09a", "#ff9a6b", "#c9b3ff"), body="#4c5160", line="#5f6a86",
        map="starlight", shine=0.1, rim=0.1, vignette=0.2, elevation=28.0,
    ),
    "studio": Preset(
        ramp=((0, "#a9a8a6"), (0.3, "#bdbcba"), (0.62, "#d3d2d0"), (0.8, "#d0d0d0"), (1, "#b4b6ba")),
        sun=(-0.5, 0.85, 0.35), key=(0.92, 0.88, 0.80), above=(0.42, 0.45, 0.50), below=(0.22, 0.21, 0.20),
        subject=("#b4533c", "#2f6f9f", "#d9a441", "#5b8c5a"), body="#8f9299", line="#3b3d42",
        floor=True, by="speed", corners=0.85, shadow=0.9, shine=0.10, rim=0.05, vignette=0.16, elevation=17.0,
    ),
    "water": Preset(
        ramp=((0, "#031a30"), (0.3, "#06304f"), (0.62, "#0c5480"), (0.86, "#2a86ad"), (1, "#5db4c9")),
        sun=(-0.25, 0.93, 0.25), key=(1.1, 1.25, 1.2), above=(0.34, 0.52, 0.58), below=(0.02, 0.08, 0.13),
        subject=("#a9bfc6", "#e07b39", "#e2c65c", "#c8554b"), body="#3f5d6c", line="#8fb3bd",
        shafts=True, fog=0.72, corners=0.5, shine=0.35, rim=0.06, elevation=18.0, darts="fish",
    ),
    "paper": Preset(
        ramp=((0, "#f3eee3"), (1, "#f6f2e9")),
        sun=(-0.4, 0.6, 0.7), key=(0.62, 0.60, 0.57), above=(0.48, 0.48, 0.48), below=(0.48, 0.48, 0.48),
        subject=("#34495e", "#c0532f", "#3f7d5a", "#8d5a97"), body="#6d6a64", line="#45433f",
        by="heading", map="phase", shine=0.0, rim=0.0, vignette=0.06, elevation=35.0, darts="darts",
    ),
}  # fmt: skip


POOL = (0.07, 0.078, 0.1)  # light on a dark floor
DIM = 0.12  # mean light of a background that is dark


def preset_of(background: Background) -> Preset:
    """The preset of that name; two colours make one with the light of the night or the studio."""
    if isinstance(background, str):
        return PRESETS[background]
    bottom, top = background
    bright = float(np.mean([hex_to_linear(bottom), hex_to_linear(top)])) > 0.25
    base = PRESETS["studio" if bright else "night"]
    return replace(base, ramp=((0, bottom), (1, top)), floor=False, shadow=0.0)


def with_shadows(preset: Preset, wanted: bool | None) -> Preset:
    """The preset with shadows and dark corners as a look wants them; None: its own."""
    if wanted is None:
        return preset
    studio = PRESETS["studio"]
    return replace(
        preset,
        shadow=(preset.shadow or studio.shadow) * wanted,
        corners=(preset.corners or studio.corners) * wanted,
    )


def with_floor(preset: Preset, wanted: bool | None, wet: bool) -> Preset:
    """The preset with a floor as a look wants it; None: its own, and in the dark under what is `wet`."""
    dark = is_dark(preset) and not preset.shafts
    if wanted is None:
        wanted = preset.floor or (wet and dark)
    if wanted == preset.floor:
        return preset
    if not wanted:
        return replace(preset, floor=False)
    studio = PRESETS["studio"]
    return replace(
        preset, floor=True, shadow=studio.shadow, corners=studio.corners, pool=POOL if dark else None
    )


def is_dark(preset: Preset) -> bool:
    """Whether there is little light behind the action."""
    lower = ramp_colors(preset.ramp, np.linspace(0.0, 0.5, 8, dtype=np.float32))
    return not preset.sky and float(lower.mean()) < DIM


def stage_array(preset: Preset, camera: Float, floor: float, exposure: float) -> Float:
    """What the shading kernels read (see layout): the sun stands where it suits this camera."""
    out = np.zeros(layout.STAGE_SIZE, np.float32)
    sun = np.array(preset.sun) / np.linalg.norm(preset.sun)
    level = _level_axes(camera)
    out[0:3] = sun @ level
    out[3:6] = np.array(preset.key) * exposure
    out[6:9] = np.array(preset.above) * exposure
    out[9:12] = np.array(preset.below) * exposure
    out[layout.SHINE], out[layout.RIM] = preset.shine, preset.rim
    out[layout.FLOOR], out[layout.FLOOR_HEIGHT] = preset.floor, floor
    out[layout.SHADOW], out[layout.CORNER] = preset.shadow, preset.corners
    out[layout.SOFTNESS] = 0.12
    return out


def _level_axes(camera: Float) -> NDArray[np.float64]:
    """Rows: right, world up, level towards the camera; its own axes when it looks straight down."""
    right = camera[3:6].astype(np.float64)
    if abs(camera[10]) > 0.98:
        return np.stack([right, camera[6:9], -camera[9:12]])
    up = np.array([0.0, 1.0, 0.0])
    return np.stack([right, up, np.cross(right, up)])


class Backdrop:
    """Background pictures of one size; what does not change from frame to frame is kept."""

    def __init__(self, preset: Preset, width: int, height: int) -> None:
        self._preset, self._width, self._height = preset, width, height
        self._key: tuple[float, float] | None = None
        self._still: Float = np.zeros((height, width, 3), np.float32)
        self._shafts = _Shafts(width, height) if preset.shafts else None

    def picture(self, camera: Float, time: float) -> Float:
        """The background behind `camera` at `time` [s]; not to be changed."""
        key = (round(float(camera[10]), 5), float(camera[FOCAL]))
        if key != self._key:
            self._key = key
            self._still = self._draw_still(camera)
        if self._preset.sky:
            return self._with_land(self._still, camera)
        if self._shafts is not None:
            return self._still + self._shafts.light(time)
        return self._still

    def _draw_still(self, camera: Float) -> Float:
        height, width = self._height, self._width
        row = np.arange(height, dtype=np.float32)[:, None] + np.float32(0.5)
        column = np.arange(width, dtype=np.float32)[None, :] + np.float32(0.5)
        x: Float = ((column - 0.5 * width) / height).astype(np.float32)
        y: Float = ((0.5 * height - row) / height).astype(np.float32)
        if self._preset.sky:
            rise = self._elevation(camera, x * height, y * height)
            picture = ramp_colors(self._preset.ramp, rise)
        else:
            rise = (y + np.float32(0.5)).astype(np.float32)
            picture = np.broadcast_to(ramp_colors(self._preset.ramp, rise), (height, width, 3))
        away = np.sqrt(x * x + 1.3 * y * y)
        shade_off = 1.0 - self._preset.vignette * np.clip(away / 0.95, 0, 1) ** 2
        return np.ascontiguousarray(picture * shade_off[..., None], dtype=np.float32)

    def _focal(self, camera: Float) -> float:
        """Focal length [pixels] for what is far away; a usual one where the camera has none."""
        return float(camera[FOCAL]) if camera[PERSPECTIVE] > 0.5 else 1.6 * self._height

    def _elevation(self, camera: Float, x: Float, y: Float) -> Float:
        """Degrees above the horizon of pixels given from the centre."""
        f = self._focal(camera)
        up = camera[7] * y + camera[10] * f + camera[4] * x
        return np.degrees(np.arcsin(np.clip(up / np.sqrt(x * x + y * y + f * f), -1, 1))).astype(np.float32)

    def _with_land(self, still: Float, camera: Float) -> Float:
        """The sky with a far skyline below it, which turns with the camera."""
        f = self._focal(camera)
        column = np.arange(self._width) + 0.5 - 0.5 * self._width
        azimuth = np.arctan2(camera[9], camera[11]) + np.arctan2(-column, f)
        pitch = np.arcsin(np.clip(camera[10], -1, 1))
        level = 0.5 * self._height + f * np.tan(pitch)  # row of the horizon
        picture = still.copy()
        for turn, rise, wave, color in ((0.0, 1.3, 1.0, "#a08d92"), (2.1, 0.35, 2.3, "#4a4350")):
            hills = rise + 0.45 * _hills(azimuth * wave + turn)
            top = level - f * np.tan(np.radians(hills))
            _fill_below(picture, top.astype(np.float32), hex_to_linear(color))
        return picture


def _hills(azimuth: NDArray[np.float64]) -> NDArray[np.float64]:
    """A gentle skyline that closes after a turn."""
    out = np.zeros_like(azimuth)
    for waves, size, phase in (
        (5, 1.0, 0.3),
        (11, 0.55, 1.9),
        (23, 0.3, 4.0),
        (61, 0.13, 0.7),
        (149, 0.07, 2.2),
    ):
        out += size * np.sin(waves * azimuth + phase)
    return out


def _fill_below(picture: Float, top: Float, color: Float) -> None:
    """Paint `picture` with `color` below the row `top` of each column, its edge smooth."""
    first = int(np.clip(np.floor(top.min()), 0, len(picture)))
    rows = np.arange(first, len(picture), dtype=np.float32)[:, None] + 0.5
    cover = np.clip(rows - top[None, :] + 0.5, 0.0, 1.0)[..., None]
    picture[first:] += (color - picture[first:]) * cover


def ramp_colors(ramp: Ramp, height: Float) -> Float:
    """Colours of `ramp` at heights, smooth between its steps; linear light (..., 3)."""
    places = np.array([place for place, _ in ramp], np.float32)
    encoded = np.array([[int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)] for _, color in ramp])
    fine = np.linspace(places[0], places[-1], 512)
    table = to_linear(np.clip(PchipInterpolator(places, encoded)(fine), 0, 1))
    share = np.clip((height - places[0]) / (places[-1] - places[0]), 0, 1) * (len(fine) - 1)
    low = np.minimum(share.astype(np.int32), len(fine) - 2)
    part = (share - low)[..., None]
    return table[low] * (1 - part) + table[low + 1] * part


class _Shafts:
    """Light shafts from above the picture, slowly moving."""

    def __init__(self, width: int, height: int) -> None:
        x = (np.arange(width, dtype=np.float32)[None, :] + 0.5 - 0.42 * width) / height
        y = (np.arange(height, dtype=np.float32)[:, None] + 0.5) / height
        angle = np.arctan2(x, y + 0.55)
        self._index = (np.clip((angle + radians(75)) / radians(150), 0, 1) * 1023).astype(np.int32)
        fade = np.exp(-2.1 * y) * np.exp(-1.6 * (x * 0.8) ** 2)
        self._fade = (fade[..., None] * np.array((0.055, 0.15, 0.17))).astype(np.float32)

    def light(self, time: float) -> Float:
        """What they add to the picture at `time` [s]."""
        angle = np.linspace(0, 1, 1024)
        rays = np.zeros(1024)
        for waves, speed, size in ((9, 0.11, 1.0), (17, -0.16, 0.7), (31, 0.23, 0.5), (53, -0.3, 0.3)):
            rays += size * np.sin(2 * np.pi * (waves * angle + speed * time) + waves)
        strength: Float = (np.clip(0.35 + 0.3 * rays, 0, None) ** 1.4).astype(np.float32)
        return strength[self._index][..., None] * self._fade
