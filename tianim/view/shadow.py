"""Shadow kernels: where light does not reach, found from depths alone.

Cast shadows come from a key buffer drawn as the sun sees it, edges softer the farther the caster;
corners are dark by what stands in front of a pixel around it. Both are found roughly, with another
few taps for each of 4 x 4 pixels, and averaged over pixels of the same surface where they are used.
"""

from tianim.lang import f32_1d, f32_2d, f32_3d, i64_2d, ti
from tianim.view.layout import (
    CORNER,
    FAR,
    FLOOR,
    FLOOR_HEIGHT,
    FOCAL,
    NEAR,
    PERSPECTIVE,
    SHADOW,
    SOFTNESS,
    WIDTH,
    depth_of,
    ray,
    to_screen,
    to_view,
    to_world,
)

SHADOW_TAPS = 10
CORNER_TAPS = 8
LARGEST_PENUMBRA = 0.025  # of the width of the shadow map
GOLDEN = (-0.7373688, 0.6754903)  # cosine and sine of the golden angle: taps in a sunflower spiral


@ti.func
def noise(x, y):
    """A number in 0..1 fixed for each pixel (interleaved gradient noise, Jimenez 2014)."""
    v = 0.06711056 * ti.cast(x, ti.f32) + 0.00583715 * ti.cast(y, ti.f32)
    v = 52.9829189 * (v - ti.floor(v))
    return v - ti.floor(v)


@ti.func
def floor_depth(camera: ti.template(), stage: ti.template(), x, y):
    """Depth at which a pixel shows the floor, FAR where it does not."""
    found = FAR
    if stage[FLOOR] > 0.5:
        r = ray(camera, x, y)
        rise = camera[4] * r[0] + camera[7] * r[1]
        drop = stage[FLOOR_HEIGHT] - camera[1]
        if camera[PERSPECTIVE] > 0.5:
            rise += camera[10]
            if drop * rise > 0.0:
                found = drop / rise
        elif ti.abs(camera[10]) > 1e-6:
            found = (drop - rise) / camera[10]
    return ti.select(found > camera[NEAR], found, FAR)


@ti.kernel
def scene_depth(out: f32_2d, key: i64_2d, camera: f32_1d, stage: f32_1d):
    """Depth [m] of each pixel (height, width) at its central sample, the floor included."""
    samples = key.shape[0] // out.shape[0]
    for y, x in out:
        found = key[y * samples + samples // 2, x * samples + samples // 2]
        floor = floor_depth(camera, stage, x + 0.5, y + 0.5)
        out[y, x] = ti.min(depth_of(found), floor)


@ti.kernel
def light_pool(out: f32_3d, background: f32_3d, camera: f32_1d, stage: f32_1d, pool: f32_1d):
    """The background with light on its floor: middle x and z [m], width [m], colour."""
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        z = floor_depth(camera, stage, x + 0.5, y + 0.5)
        share = 0.0
        if z < 0.5 * FAR:
            p = to_world(camera, x + 0.5, y + 0.5, z)
            q = ((p[0] - pool[0]) ** 2 + (p[2] - pool[1]) ** 2) / (pool[2] * pool[2])
            share = 1.0 / (1.0 + q) ** 2
        for c in ti.static(range(3)):
            out[y, x, c] = background[y, x, c] + share * pool[3 + c]


@ti.func
def enclosure(depth: ti.template(), camera: ti.template(), reach, x, y):
    """How far a pixel is enclosed, 0..1, from pairs of opposite depths within `reach` [m].

    Opposite pairs make a slope count as nothing: only corners and what stands in front count.
    """
    height, width = depth.shape[0], depth.shape[1]
    z = depth[y, x]
    w = ti.select(camera[PERSPECTIVE] > 0.5, z, 1.0)
    pixels = ti.min(reach * camera[FOCAL] / w, 0.12 * height)
    turn = 6.2831853 * noise(x % 4, y % 4)
    cx, cy = ti.cos(turn), ti.sin(turn)
    enclosed = 0.0
    for k in range(CORNER_TAPS):
        far = pixels * ti.sqrt((k + 0.5) / CORNER_TAPS)
        cx, cy = cx * GOLDEN[0] - cy * GOLDEN[1], cx * GOLDEN[1] + cy * GOLDEN[0]
        dx, dy = ti.cast(ti.round(cx * far), ti.i32), ti.cast(ti.round(cy * far), ti.i32)
        sum_front, near = 0.0, 1.0
        for side in ti.static(range(2)):
            sx = ti.min(ti.max(x + (1 - 2 * side) * dx, 0), width - 1)
            sy = ti.min(ti.max(y + (1 - 2 * side) * dy, 0), height - 1)
            front = (z - depth[sy, sx]) / reach
            near *= ti.min(ti.max(2.0 - front, 0.0), 1.0)  # far in front: another thing
            sum_front += ti.min(ti.max(front, -1.0), 1.0)
        enclosed += near * ti.min(ti.max(sum_front, 0.0), 1.0)
    # Where the reach is but a few pixels (towards the horizon) there is nothing to tell.
    return enclosed / CORNER_TAPS * ti.min(ti.max(0.25 * pixels - 0.5, 0.0), 1.0)


@ti.func
def casts_near(casters: ti.template(), sun: ti.template(), v):
    """Whether anything round the light ray through `v` (seen from the sun) lies nearer to the sun."""
    s = to_screen(sun, v)
    tile = ti.cast(sun[WIDTH], ti.i32) // casters.shape[0]
    x, y = ti.cast(ti.floor(s[0] / tile), ti.i32), ti.cast(ti.floor(s[1] / tile), ti.i32)
    found = False
    if 0 <= x < casters.shape[1] and 0 <= y < casters.shape[0]:
        found = v[2] > casters[y, x]
    return found


@ti.func
def shadow_at(shadow: ti.template(), sun: ti.template(), v, softness, pixel_noise):
    """Share of the key light that reaches `v` (seen from the sun): nearer casters give sharper edges."""
    s = to_screen(sun, v)
    size = shadow.shape[0]
    texel = 1.0 / sun[FOCAL]
    turn = 6.2831853 * pixel_noise
    cx, cy = ti.cos(turn), ti.sin(turn)
    blockers, gap, open_taps = 0.0, 0.0, 0.0
    reach = LARGEST_PENUMBRA * size
    for step in range(2 * SHADOW_TAPS):
        k = step % SHADOW_TAPS
        if step == SHADOW_TAPS:
            reach = ti.min(ti.max(softness * gap / ti.max(blockers, 1.0) / texel, 1.2), reach)
        far = reach * ti.sqrt((k + 0.5) / SHADOW_TAPS)
        cx, cy = cx * GOLDEN[0] - cy * GOLDEN[1], cx * GOLDEN[1] + cy * GOLDEN[0]
        x, y = ti.cast(ti.floor(s[0] + cx * far), ti.i32), ti.cast(ti.floor(s[1] + cy * far), ti.i32)
        depth = FAR
        if 0 <= x < size and 0 <= y < size:
            depth = depth_of(shadow[y, x])
        behind = v[2] - depth - texel * (1.5 + 1.2 * far)
        if step < SHADOW_TAPS:
            if behind > 0.0:
                blockers += 1.0
                gap += v[2] - depth
        elif behind <= 0.0:
            open_taps += 1.0
    return ti.select(blockers > 0.0, open_taps / SHADOW_TAPS, 1.0)


@ti.kernel
def find_shade(
    out: f32_3d,
    depth: f32_2d,
    shadow: i64_2d,
    casters: f32_2d,
    camera: f32_1d,
    sun: f32_1d,
    stage: f32_1d,
    reach: ti.f32,
):
    """Per pixel (height, width, 2): how far it is enclosed, and the share of the key light that it gets.

    `casters` (n, n): nearest depth of the shadow map round each tile. Both values are rough, with a
    pattern of 4 x 4 pixels that `resolve` averages away.
    """
    for y, x in depth:
        enclosed, lit = 0.0, 1.0
        if depth[y, x] < FAR * 0.5:
            alone = False
            if stage[SHADOW] > 0.0:
                p = to_world(camera, x + 0.5, y + 0.5, depth[y, x])
                v = to_view(sun, p[0], p[1], p[2])
                if casts_near(casters, sun, v):
                    lit = shadow_at(shadow, sun, v, stage[SOFTNESS], noise(x % 4, y % 4))
                else:
                    alone = p[1] < stage[FLOOR_HEIGHT] + 0.01 * reach
            if stage[CORNER] > 0.0 and not alone:
                enclosed = enclosure(depth, camera, reach, x, y)
        out[y, x, 0] = enclosed
        out[y, x, 1] = lit


@ti.func
def averaged_shade(rough: ti.template(), depth: ti.template(), reach, x, y, z):
    """Enclosure and light at depth `z`, from the 4 x 4 pixels round (x, y) that show the same surface."""
    height, width = depth.shape[0], depth.shape[1]
    weights = 1e-3  # its own pixel counts always
    enclosed, lit = weights * rough[y, x, 0], weights * rough[y, x, 1]
    for k in range(16):
        sy = ti.min(ti.max(y + k // 4 - 2, 0), height - 1)
        sx = ti.min(ti.max(x + k % 4 - 2, 0), width - 1)
        near = ti.abs(depth[sy, sx] - z) / reach
        weight = ti.select(near < 1.0, 1.0, 0.0)
        enclosed += weight * rough[sy, sx, 0]
        lit += weight * rough[sy, sx, 1]
        weights += weight
    return enclosed / weights, lit / weights
