"""Caustics: the light of the sun under liquids, so that their shadow is bright and tinted, not black.

A sheet of light as wide as the shadow map falls on the liquid. What meets it is bent, loses its share by
Fresnel and by Beer and Lambert, and lands on the floor somewhere else; what does not goes straight on.
The energy that lands in each texel is counted, as the sun sees the floor, in fixed point so that the order
does not show. Limits: light is bent once, where it goes in; things under the liquid get the light that
the floor behind them would get.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tianim.lang import f32_1d, f32_2d, f32_3d, i32_2d, i64_2d, ti
from tianim.view import layout, liquid, liquid_light, raster
from tianim.view.layout import (
    EMPTY,
    FAR,
    FLOOR_HEIGHT,
    LOW_WORD,
    SHADOW,
    depth_of,
    i64_3d,
    to_screen,
    to_view,
    to_world,
)
from tianim.view.liquid import Liquid

Float = NDArray[np.float32]

SIZE = 768  # texels along each side of the sheet of light
STEPS = 1 << 16  # steps of energy in the light of one texel
BLUR = 2.2  # standard deviation of the light that lands [texels]: the sun is no point
BRIGHTEST = 2.2  # most light that is shown, over that of the sun itself
FLOOR_SHARE = 0.6  # share of the floor's light that comes from the sun (see shade.resolve)
SEEN_BELOW = 0.02  # a thing is under a liquid when it lies this much deeper [of the radius of the action]


@ti.kernel
def send_light(
    landed: i64_3d, key: i64_2d, total: i64_2d, sun: f32_1d, stage: f32_1d, substance: f32_1d,
    position: f32_2d, normal: f32_2d, triangles: i32_2d, unit: ti.f32, soft: ti.f32,
):  # fmt: skip
    """Add the light (height, width, 3) [STEPS] that goes through a liquid, where it lands on the floor."""
    height, width = key.shape[0], key.shape[1]
    for y, x, c in landed:
        landed[y, x, c] = ti.select(key[y, x] == ti.i64(EMPTY), ti.i64(STEPS), ti.i64(0))
    down = ti.Vector([-stage[c] for c in ti.static(range(3))])
    for y, x in key:
        found = key[y, x]
        if found != ti.i64(EMPTY):
            z = depth_of(found)
            p = to_world(sun, x + 0.5, y + 0.5, z)
            n = liquid.smooth_normal(
                position, normal, triangles, ti.cast(found & ti.i64(LOW_WORD), ti.i32), p
            )
            n = ti.select(n.dot(down) > 0.0, -n, n)
            way = ti.abs(ti.cast(total[y, x], ti.f32)) * unit
            if liquid.count_of(total[y, x]) != 0:
                way = 0.0
            # Leaves through the back: bent the other way, but for what lies on the floor.
            ahead = liquid_light.bent(down, n, 1.0 / substance[liquid_light.REFRACTION])
            floor = stage[FLOOR_HEIGHT]
            inside = p + ahead * ti.min(way, ti.max((floor - p[1]) / ti.min(ahead[1], -0.05), 0.0))
            air = ti.max((floor - inside[1]) / ti.min(down[1], -0.05), 0.0)
            q = inside + (down + (ahead - down) * soft) * air
            s = to_screen(sun, to_view(sun, q[0], q[1], q[2]))
            through = 1.0 - liquid_light.fresnel(-n.dot(down), substance[liquid_light.REFRACTION])
            left = liquid_light.left_over(substance, way)
            sx, sy = s[0] - 0.5, s[1] - 0.5
            x0, y0 = ti.cast(ti.floor(sx), ti.i32), ti.cast(ti.floor(sy), ti.i32)
            for k in ti.static(range(4)):
                tx, ty = x0 + k % 2, y0 + k // 2
                weight = ti.select(k % 2 == 1, sx - x0, 1.0 - sx + x0)
                weight *= ti.select(k // 2 == 1, sy - y0, 1.0 - sy + y0)
                if 0 <= tx < width and 0 <= ty < height:
                    for c in ti.static(range(3)):
                        energy = ti.cast(weight * through * left[c] * STEPS, ti.i64)
                        ti.atomic_add(landed[ty, tx, c], energy)


@ti.kernel
def light_up(
    picture: f32_3d, depth: f32_2d, landed: f32_3d, nearest: f32_2d, camera: f32_1d, sun: f32_1d,
    shade: f32_3d, stage: f32_1d, behind: ti.f32,
):  # fmt: skip
    """Change the light of what the sun reaches through a liquid; `nearest`: depth of the liquid from the sun.

    `landed` (height, width, 3) is over the light of the sun; `shade` as in shadow.find_shade.
    """
    height, width = landed.shape[0], landed.shape[1]
    for y, x in depth:
        z = depth[y, x]
        if z < 0.5 * FAR:
            p = to_world(camera, x + 0.5, y + 0.5, z)
            v = to_view(sun, p[0], p[1], p[2])
            s = to_screen(sun, v)
            tx, ty = ti.cast(ti.floor(s[0]), ti.i32), ti.cast(ti.floor(s[1]), ti.i32)
            if 0 < tx < width - 1 and 0 < ty < height - 1:
                on_floor = ti.abs(p[1] - stage[FLOOR_HEIGHT]) < behind
                if on_floor or v[2] > nearest[ty, tx] + behind:
                    lit = 1.0 - stage[SHADOW] * (1.0 - shade[y, x, 1])
                    light = liquid_light.picked(landed, s[0], s[1])
                    for c in ti.static(range(3)):
                        gain = 1.0 + FLOOR_SHARE * lit * (light[c] - 1.0)
                        picture[y, x, c] *= gain


class Caustics:
    """The sheet of light, for liquids in a film."""

    def __init__(self) -> None:
        self._key = np.empty((SIZE, SIZE), np.int64)
        self._total = np.empty((SIZE, SIZE), np.int64)
        self._landed = np.empty((SIZE, SIZE, 3), np.int64)
        self._open = np.full((SIZE, SIZE), layout.FAR, np.float32)

    def cast(
        self, picture: Float, depth: Float, shade: Float, one: Liquid, camera: Float, sun: Float,
        stage: Float, radius: float,
    ) -> None:  # fmt: skip
        """Light what is under the liquid `one` in `picture`; `sun` is the camera of the shadow map."""
        fine = sun.copy()
        fine[[layout.FOCAL, layout.WIDTH, layout.HEIGHT]] *= SIZE / sun[layout.WIDTH]
        unit = 16.0 * radius / liquid.STEPS
        self._key.fill(layout.EMPTY)
        self._total.fill(0)
        raster.raster_triangles(self._key, fine, one.position, one.triangles, 0)
        liquid.add_faces(self._total, fine, self._open, one.position, one.triangles, unit)
        send_light(
            self._landed, self._key, self._total, fine, stage, one.substance.row,
            one.position, one.normal, one.triangles, unit, 0.5,
        )  # fmt: skip
        light = (self._landed * (1.0 / STEPS)).astype(np.float32)
        light = gaussian_filter(light, (BLUR, BLUR, 0), truncate=3.0)
        np.minimum(light, BRIGHTEST, out=light)
        nearest = np.where(
            self._key == layout.EMPTY,
            np.float32(layout.FAR),
            (self._key >> 32).astype(np.int32).view(np.float32),
        )
        light_up(picture, depth, light, nearest, camera, fine, shade, stage, SEEN_BELOW * radius)
