"""Liquid kernels: where the front of a closed mesh is that light goes through, and how thick it is there.

The front is the nearest surface, its coverage and normal averaged over the samples of a pixel. The
thickness is the sum of the depths of all back faces less that of all front faces, each no farther than
what is solid behind: exact for closed meshes whatever their order, and added in fixed point so that no
order shows.

front (height, width, FRONT): coverage, depth [m], normal.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.lang import f32_1d, f32_2d, f32_3d, i32_2d, i64_2d, ti
from tianim.view.layout import (
    EMPTY,
    FAR,
    HEIGHT,
    LOW_WORD,
    NEAR,
    PERSPECTIVE,
    WIDTH,
    depth_of,
    to_screen,
    to_view,
    to_world,
)
from tianim.view.material import Substance
from tianim.view.shade import to_eye

FRONT = 5  # numbers of each pixel of a front
STEPS = 1 << 20  # steps of depth over the depth range of the film
LAYER = 1 << 40  # counts faces in the same number as their depths


@dataclass(frozen=True)
class Liquid:
    """A mesh that light goes through: vertices (n, 3) [m], normals (n, 3), triangles (m, 3)."""

    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    triangles: NDArray[np.int32]
    substance: Substance


@ti.func
def corner_of(position: ti.template(), index):
    """Row `index` of positions or normals."""
    return ti.Vector([position[index, k] for k in ti.static(range(3))])


@ti.func
def smooth_normal(position: ti.template(), normal: ti.template(), triangles: ti.template(), n, p):
    """Unit normal of triangle `n` at world point `p`, blended over it."""
    a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
    pa, pb, pc = corner_of(position, a), corner_of(position, b), corner_of(position, c)
    across = (pb - pa).cross(pc - pa)
    area = ti.max(across.dot(across), 1e-36)
    share_b = ti.min(ti.max((p - pa).cross(pc - pa).dot(across) / area, 0.0), 1.0)
    share_c = ti.min(ti.max((pb - pa).cross(p - pa).dot(across) / area, 0.0), 1.0)
    share_a = ti.max(1.0 - share_b - share_c, 0.0)
    blend = corner_of(normal, a) * share_a + corner_of(normal, b) * share_b + corner_of(normal, c) * share_c
    flat = across / ti.sqrt(area)
    return (blend + 1e-4 * flat).normalized()


@ti.kernel
def mesh_normals(out: f32_2d, position: f32_2d, triangles: i32_2d):
    """Normals (n, 3) of vertices, each the sum of its triangles by their area; in order, on one core."""
    for n, c in ti.ndrange(out.shape[0], 3):
        out[n, c] = 0.0
    ti.loop_config(serialize=True)
    for n in range(triangles.shape[0]):
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        pa = corner_of(position, a)
        across = (corner_of(position, b) - pa).cross(corner_of(position, c) - pa)
        for k in ti.static(range(3)):
            out[a, k] += across[k]
            out[b, k] += across[k]
            out[c, k] += across[k]
    for n in range(out.shape[0]):
        length = ti.sqrt(ti.max(out[n, 0] ** 2 + out[n, 1] ** 2 + out[n, 2] ** 2, 1e-36))
        for k in ti.static(range(3)):
            out[n, k] /= length


@ti.kernel
def gather_front(
    front: f32_3d, key: i64_2d, solid: i64_2d, camera: f32_1d,
    position: f32_2d, normal: f32_2d, triangles: i32_2d,
):  # fmt: skip
    """The front of a liquid: `key` its own, `solid` that of all else; `camera` of samples."""
    height, width = front.shape[0], front.shape[1]
    samples = key.shape[0] // height
    for y, x in ti.ndrange(height, width):
        cover, depths, total = 0.0, 0.0, ti.Vector([0.0, 0.0, 0.0])
        last, last_normal = -1, ti.Vector([0.0, 0.0, 0.0])
        for k in range(samples * samples):
            ky, kx = y * samples + k // samples, x * samples + k % samples
            found = key[ky, kx]
            if found != ti.i64(EMPTY) and found < solid[ky, kx]:
                z = depth_of(found)
                n = ti.cast(found & ti.i64(LOW_WORD), ti.i32)
                if n != last:
                    p = to_world(camera, kx + 0.5, ky + 0.5, z)
                    last, last_normal = n, smooth_normal(position, normal, triangles, n, p)
                    eye = to_eye(camera, kx + 0.5, ky + 0.5)
                    facing = last_normal.dot(eye)
                    # A blended normal may look away near an outline: then it just grazes.
                    if facing < 0.0:
                        a = corner_of(position, triangles[n, 0])
                        across = (corner_of(position, triangles[n, 1]) - a).cross(
                            corner_of(position, triangles[n, 2]) - a
                        )
                        if across.dot(eye) < 0.0:
                            last_normal = -last_normal
                        last_normal = (last_normal - ti.min(last_normal.dot(eye), 0.0) * eye).normalized()
                cover += 1.0
                depths += z
                total += last_normal
        front[y, x, 0] = cover / (samples * samples)
        front[y, x, 1] = depths / ti.max(cover, 1.0)
        length = ti.sqrt(ti.max(total.dot(total), 1e-20))
        for c in ti.static(range(3)):
            front[y, x, 2 + c] = total[c] / length


@ti.kernel
def add_faces(
    total: i64_2d, camera: f32_1d, depth: f32_2d, position: f32_2d, triangles: i32_2d, unit: ti.f32
):
    """Add the depths of back faces, take those of front faces, in steps of `unit` [m]; LAYER counts them.

    Nothing counts behind `depth`. Pixels are taken at their middles, a triangle through the plane of
    the camera not at all.
    """
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    for n in range(triangles.shape[0]):
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        va = to_view(camera, position[a, 0], position[a, 1], position[a, 2])
        vb = to_view(camera, position[b, 0], position[b, 1], position[b, 2])
        vc = to_view(camera, position[c, 0], position[c, 1], position[c, 2])
        if ti.min(va[2], vb[2], vc[2]) > camera[NEAR]:
            sa, sb, sc = to_screen(camera, va), to_screen(camera, vb), to_screen(camera, vc)
            x0 = ti.max(0, ti.cast(ti.ceil(ti.min(sa[0], sb[0], sc[0]) - 0.5), ti.i32))
            x1 = ti.min(width, ti.cast(ti.floor(ti.max(sa[0], sb[0], sc[0]) - 0.5), ti.i32) + 1)
            y0 = ti.max(0, ti.cast(ti.ceil(ti.min(sa[1], sb[1], sc[1]) - 0.5), ti.i32))
            y1 = ti.min(height, ti.cast(ti.floor(ti.max(sa[1], sb[1], sc[1]) - 0.5), ti.i32) + 1)
            # Screen coordinates from the corner of the box, where float32 is exact enough.
            ax, ay, bx, by = sa[0] - x0, sa[1] - y0, sb[0] - x0, sb[1] - y0
            cx, cy = sc[0] - x0, sc[1] - y0
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            if ti.abs(area) > 1e-12:
                # Counterclockwise in the world is clockwise on a screen whose y points down.
                sign = ti.select(area > 0.0, ti.i64(1), ti.i64(-1))
                for y in range(y0, y1):
                    for x in range(x0, x1):
                        px, py = x - x0 + 0.5, y - y0 + 0.5
                        wa = ((bx - px) * (cy - py) - (by - py) * (cx - px)) / area
                        wb = ((cx - px) * (ay - py) - (cy - py) * (ax - px)) / area
                        wc = 1.0 - wa - wb
                        if ti.min(wa, wb, wc) >= 0.0:
                            z = wa * va[2] + wb * vb[2] + wc * vc[2]
                            if camera[PERSPECTIVE] > 0.5:
                                z = 1.0 / (wa / va[2] + wb / vb[2] + wc / vc[2])
                            z = ti.min(z, depth[y, x])
                            ti.atomic_add(total[y, x], sign * (ti.i64(LAYER) + ti.cast(z / unit, ti.i64)))


@ti.func
def count_of(total):
    """Back faces less front faces in a sum of `add_faces`: 0 where the mesh is closed."""
    return ti.cast((total + ti.i64(LAYER // 2)) >> 40, ti.i32)


@ti.kernel
def find_thickness(out: f32_2d, total: i64_2d, front: f32_3d, depth: f32_2d, unit: ti.f32, beyond: ti.f32):
    """Thickness [m] of each pixel; where the mesh is open it ends at `depth`, or `beyond` [m] further.

    A pixel on the seam of two triangles may count one of them twice or not at all: the mean of closed
    pixels round it stands for it, and smooths the facets.
    """
    height, width = out.shape[0], out.shape[1]
    for y, x in out:
        thick = 0.0
        if front[y, x, 0] > 0.0:
            sum_closed, closed, gaping = 0.0, 0.0, 0.0
            for k in range(25):
                sy, sx = y + k // 5 - 2, x + k % 5 - 2
                if 0 <= sy < height and 0 <= sx < width:
                    found = total[sy, sx]
                    if found != 0 and front[sy, sx, 0] > 0.0:
                        if count_of(found) == 0:
                            sum_closed += ti.abs(ti.cast(found, ti.f32)) * unit
                            closed += 1.0
                        else:
                            gaping += 1.0
            if closed > gaping:
                thick = sum_closed / closed
            elif gaping > 0.0:
                thick = ti.select(depth[y, x] < 0.5 * FAR, depth[y, x] - front[y, x, 1], beyond)
        out[y, x] = ti.max(thick, 0.0)
