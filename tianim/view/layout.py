"""What all picture kernels share: the layout of camera, stage and key, and projection.

A camera is a float32 array: eye 0:3, right 3:6, up 6:9, forward 9:12, then as named below. A stage
holds the light: direction of the key light 0:3, its colour 3:6, light from above 6:9, from below
9:12, then as named. A key holds depth bits << 32 | primitive id of what a sample shows. View
coordinates are (right, up, forward) [m] from the eye. Pixel centres are at (i + 0.5).
"""

from typing import Any

from tianim.lang import ti

i64_3d: Any = ti.types.ndarray(dtype=ti.i64, ndim=3)

FOCAL = 12  # pixels per unit of x / w
PERSPECTIVE = 13  # 1, or 0 for orthographic (then w = 1 and FOCAL is pixels per metre)
WIDTH = 14  # [pixels]
HEIGHT = 15
NEAR = 16  # nothing nearer is drawn [m]
CAMERA_SIZE = 17

SHINE = 12  # strength of highlights
RIM = 13  # strength of the light along outlines
FLOOR = 14  # 1 where there is a floor
FLOOR_HEIGHT = 15  # [m]
SHADOW = 16  # how dark a cast shadow is, 0: none are cast
CORNER = 17  # how dark a corner is, 0: not computed
SOFTNESS = 18  # width of a shadow's edge over its distance from what casts it
STAGE_SIZE = 19

EMPTY = 0x7FFFFFFFFFFFFFFF  # key of a sample that shows nothing
LOW_WORD = 0xFFFFFFFF
FAR = 1.0e30  # depth of the background [m]
MAX_PIXEL = 1.0e6  # screen coordinates are clamped to it, so that they fit an int32


@ti.func
def to_view(camera: ti.template(), x, y, z):
    """Coordinates (right, up, forward) [m] of a point as the camera sees it."""
    dx, dy, dz = x - camera[0], y - camera[1], z - camera[2]
    return ti.Vector(
        [
            dx * camera[3] + dy * camera[4] + dz * camera[5],
            dx * camera[6] + dy * camera[7] + dz * camera[8],
            dx * camera[9] + dy * camera[10] + dz * camera[11],
        ]
    )


@ti.func
def to_screen(camera: ti.template(), v):
    """Screen x and y [pixels], depth [m] and w (scale of a metre is FOCAL / w) of view coordinates."""
    w = ti.select(camera[PERSPECTIVE] > 0.5, ti.max(v[2], camera[NEAR] * 0.1), 1.0)
    scale = camera[FOCAL] / w
    x = ti.min(ti.max(0.5 * camera[WIDTH] + v[0] * scale, -MAX_PIXEL), MAX_PIXEL)
    y = ti.min(ti.max(0.5 * camera[HEIGHT] - v[1] * scale, -MAX_PIXEL), MAX_PIXEL)
    return ti.Vector([x, y, v[2], w])


@ti.func
def ray(camera: ti.template(), x, y):
    """View coordinates at depth 1 (perspective), or (x, y) [m] and 1 (orthographic), of a pixel."""
    return ti.Vector(
        [(x - 0.5 * camera[WIDTH]) / camera[FOCAL], (0.5 * camera[HEIGHT] - y) / camera[FOCAL], 1.0]
    )


@ti.func
def to_world(camera: ti.template(), x, y, depth):
    """World position [m] of pixel coordinates at a depth."""
    r = ray(camera, x, y)
    w = ti.select(camera[PERSPECTIVE] > 0.5, depth, 1.0)
    return ti.Vector(
        [
            camera[c] + camera[3 + c] * r[0] * w + camera[6 + c] * r[1] * w + camera[9 + c] * depth
            for c in ti.static(range(3))
        ]
    )


@ti.func
def across_view(camera: ti.template(), right, up, back):
    """World direction of view components; `back` points at the camera."""
    return ti.Vector(
        [camera[3 + c] * right + camera[6 + c] * up - camera[9 + c] * back for c in ti.static(range(3))]
    )


@ti.func
def depth_of(found):
    """Depth [m] in a key, FAR where nothing was found."""
    depth = ti.bit_cast(ti.cast(found >> 32, ti.i32), ti.f32)
    return ti.select(found == ti.i64(EMPTY), FAR, depth)


@ti.func
def clipped(camera: ti.template(), v, other):
    """View coordinates `v`, moved along the segment to `other` until in front of the camera."""
    near = camera[NEAR] * 1.01
    moved = v
    if v[2] < near and other[2] > near:
        moved = v + (other - v) * ((near - v[2]) / (other[2] - v[2]))
    return moved


@ti.func
def along_segment(sa, sb, x, y):
    """Parameter 0..1 of the point of a screen segment nearest to (x, y), and the distance [pixels]."""
    dx, dy = sb[0] - sa[0], sb[1] - sa[1]
    t = ((x - sa[0]) * dx + (y - sa[1]) * dy) / ti.max(dx * dx + dy * dy, 1e-12)
    t = ti.min(ti.max(t, 0.0), 1.0)
    ex, ey = x - (sa[0] + t * dx), y - (sa[1] + t * dy)
    return t, ti.sqrt(ex * ex + ey * ey)


@ti.func
def faded(fog: ti.template(), depth):
    """Share of the colour that is left at `depth`; fog is (start [m], length [m], share lost over it)."""
    through = ti.max((depth - fog[0]) / fog[1], 0.0)
    return ti.pow(1.0 - fog[2], through)
