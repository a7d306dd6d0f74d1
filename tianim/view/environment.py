"""Environments: what a glossy surface mirrors, made to fit each background.

A table of linear light by direction, as seen where the camera stands: rows from straight down to straight
up, columns once round, the way to the camera in the middle. Studios have softboxes, skies a sun. There is
one table for each of ROUGHNESS, the rougher the more blurred, stacked along the rows.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tianim.lang import ti
from tianim.view.backdrop import Preset, is_dark, ramp_colors

Float = NDArray[np.float32]

ROWS, COLUMNS = 128, 256
ROUGHNESS = (0.0, 0.15, 0.4, 1.0)  # of each table
TABLES = 4
BLUR = (0.0, 4.0, 12.0, 32.0)  # standard deviation of each [degrees]
# Softboxes: azimuth from the camera to its right, elevation, half width, half height, width of the soft
# edge [degrees], light over that of the key.
STUDIO = (
    (-48.0, 60.0, 34.0, 15.0, 5.0, 6.0),  # the key, above on the left
    (64.0, 34.0, 8.0, 24.0, 4.0, 3.5),  # a strip on the right
    (172.0, 46.0, 50.0, 8.0, 6.0, 2.0),  # a long one behind the subject: bright edges
    (-118.0, 26.0, 6.0, 22.0, 5.0, 1.8),  # a strip on the left, behind
)
# In the dark outlines are all that is seen: strips on both sides, and a wide one behind.
DARKROOM = (
    (-48.0, 60.0, 36.0, 15.0, 6.0, 5.0),
    (98.0, 24.0, 12.0, 34.0, 6.0, 3.0),
    (-104.0, 24.0, 12.0, 34.0, 6.0, 3.0),
    (180.0, 46.0, 70.0, 9.0, 9.0, 1.8),
)
SUN = (2.2, 3.0, 30.0)  # half width of the sun of a sky, its soft edge [degrees], its light
GLOW = (26.0, 1.6)  # width of the glow round it [degrees], its light
BACKGROUND = (-55.0, 62.0)  # elevations of the bottom and the top of a background that is no sky [degrees]
LAND = (0.16, 0.14, 0.14)  # below the horizon of a sky


def environment(preset: Preset) -> Float:
    """Light by direction, shape (len(ROUGHNESS) * ROWS, COLUMNS, 3)."""
    rise = np.linspace(-90, 90, 2 * ROWS + 1, dtype=np.float32)[1::2, None]
    turn = np.linspace(-180, 180, 2 * COLUMNS + 1, dtype=np.float32)[None, 1::2]
    light = _sky(preset, rise, turn) if preset.sky else _room(preset, rise, turn)
    tables = [_blurred(light, degrees) for degrees in BLUR]
    return np.ascontiguousarray(np.concatenate(tables), dtype=np.float32)


def _sky(preset: Preset, rise: Float, turn: Float) -> Float:
    """The ramp of the sky with its sun in it, over dark land."""
    sky = np.broadcast_to(ramp_colors(preset.ramp, np.maximum(rise, 0.5)), (ROWS, COLUMNS, 3))
    land = np.clip(0.5 - rise / 3.0, 0.0, 1.0)[..., None]
    light = sky * (1 - land) + np.array(LAND) * land
    away = _away(preset.sun, rise, turn)
    half, edge, bright = SUN
    disc = np.clip((half + edge - away) / edge, 0.0, 1.0) ** 2 * bright
    glow = np.exp(-0.5 * (away / GLOW[0]) ** 2) * GLOW[1]
    return light + ((disc + glow) * (rise > 0))[..., None] * np.array(preset.key)


def _room(preset: Preset, rise: Float, turn: Float) -> Float:
    """The background all round, with softboxes above it."""
    bottom, top = BACKGROUND
    share = (rise - bottom) / (top - bottom) * (preset.ramp[-1][0] - preset.ramp[0][0]) + preset.ramp[0][0]
    light = np.broadcast_to(ramp_colors(preset.ramp, share), (ROWS, COLUMNS, 3)).copy()
    if preset.pool is not None:
        light += np.array(preset.pool) * np.clip(0.6 - rise / 25.0, 0.0, 1.0)[..., None]
    boxes = DARKROOM if is_dark(preset) else STUDIO
    for azimuth, elevation, width, height, edge, bright in boxes:
        across = np.abs((turn - azimuth + 180) % 360 - 180) * np.cos(np.radians(rise))
        inside = np.minimum(width - across, height - np.abs(rise - elevation))
        light += (np.clip(0.5 + inside / edge, 0, 1) * bright)[..., None] * np.array(preset.key)
    return light


def _away(sun: tuple[float, float, float], rise: Float, turn: Float) -> NDArray[Any]:
    """Angle between each direction and the sun [degrees]."""
    e, a = np.radians(rise), np.radians(turn)
    direction = np.stack(
        np.broadcast_arrays(np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)), axis=-1
    )
    cosine = direction @ (np.array(sun) / np.linalg.norm(sun))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _blurred(light: Float, degrees: float) -> Float:
    if degrees == 0.0:
        return light
    rows = gaussian_filter1d(light, degrees * ROWS / 180, axis=0, mode="nearest")
    return gaussian_filter1d(rows, degrees * COLUMNS / 360, axis=1, mode="wrap")


@ti.func
def mirrored_light(table: ti.template(), camera: ti.template(), direction, roughness):
    """Linear light from `direction` (world, unit), blurred for `roughness`; see `environment`."""
    # Axes of the table: the camera's right, world up, level towards the camera.
    right = direction[0] * camera[3] + direction[2] * camera[5]
    toward = direction[2] * camera[3] - direction[0] * camera[5]
    rise = ti.atan2(direction[1], ti.sqrt(ti.max(right * right + toward * toward, 1e-12)))
    column = (ti.atan2(right, toward) / 6.2831853 + 0.5) * COLUMNS - 0.5
    row = ti.min(ti.max((rise / 3.1415927 + 0.5) * ROWS - 0.5, 0.0), ROWS - 1.001)
    level = 0.0
    for k in ti.static(range(len(ROUGHNESS) - 1)):
        step = (roughness - ROUGHNESS[k]) / (ROUGHNESS[k + 1] - ROUGHNESS[k])
        level += ti.min(ti.max(step, 0.0), 1.0)
    low = ti.min(ti.cast(level, ti.i32), TABLES - 2)
    x0, y0 = ti.cast(ti.floor(column), ti.i32), ti.cast(row, ti.i32)
    fx, fy, fl = column - x0, row - y0, level - low
    light = ti.Vector([0.0, 0.0, 0.0])
    for k in range(8):
        i, j, table_of = k % 2, k // 2 % 2, k // 4
        weight = ti.select(i == 1, fx, 1.0 - fx) * ti.select(j == 1, fy, 1.0 - fy)
        weight *= ti.select(table_of == 1, fl, 1.0 - fl)
        y, x = (low + table_of) * ROWS + y0 + j, (x0 + i + COLUMNS) % COLUMNS
        for c in ti.static(range(3)):
            light[c] += weight * table[y, x, c]
    return light
