"""Shading kernels: light, shadow, corners and fog for what the raster kernels found to be visible.

The colour of a sample is worked out once per primitive and pixel: where all samples of a pixel
show the same primitive, one stands for all. Colours are linear light until the last line.
"""

from tianim.lang import f32_1d, f32_2d, f32_3d, i32_2d, i64_2d, ti, u8_3d
from tianim.view.raster import (
    EMPTY,
    FOCAL,
    HEIGHT,
    LOW_WORD,
    NEAR,
    PERSPECTIVE,
    WIDTH,
    along_segment,
    clipped,
    faded,
    i64_3d,
    to_screen,
    to_view,
)

# Layout of a stage array: direction of the key light 0:3, its colour 3:6, light from above 6:9,
# from below 9:12, then these.
SHINE = 12  # strength of highlights
RIM = 13  # strength of the light along outlines
FLOOR = 14  # 1 where there is a floor
FLOOR_HEIGHT = 15  # [m]
SHADOW = 16  # how dark a cast shadow is, 0: none are cast
CORNER = 17  # how dark a corner is, 0: not computed
SOFTNESS = 18  # width of a shadow's edge over its distance from what casts it
STAGE_SIZE = 19

FAR = 1.0e30  # depth of the background [m]
SHADOW_TAPS = 10
CORNER_TAPS = 8
ENCODING_STEPS = 1024.0  # entries of the encoding table for each unit of the root of light
ENCODING_SIZE = 4096
LARGEST_PENUMBRA = 0.025  # of the width of the shadow map
GOLDEN = (-0.7373688, 0.6754903)  # cosine and sine of the golden angle: taps in a sunflower spiral
CREASE = 0.72  # cosine of the angle from which an edge is drawn sharp


@ti.func
def noise(x, y):
    """A number in 0..1 fixed for each pixel (interleaved gradient noise, Jimenez 2014)."""
    v = 0.06711056 * ti.cast(x, ti.f32) + 0.00583715 * ti.cast(y, ti.f32)
    v = 52.9829189 * (v - ti.floor(v))
    return v - ti.floor(v)


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


@ti.func
def depth_of(found):
    """Depth [m] in a key, FAR where nothing was found."""
    depth = ti.bit_cast(ti.cast(found >> 32, ti.i32), ti.f32)
    return ti.select(found == ti.i64(EMPTY), FAR, depth)


@ti.kernel
def scene_depth(out: f32_2d, key: i64_2d, camera: f32_1d, stage: f32_1d):
    """Depth [m] of each pixel (height, width) at its central sample, the floor included."""
    samples = key.shape[0] // out.shape[0]
    for y, x in out:
        found = key[y * samples + samples // 2, x * samples + samples // 2]
        floor = floor_depth(camera, stage, x + 0.5, y + 0.5)
        out[y, x] = ti.min(depth_of(found), floor)


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


@ti.func
def lit_color(stage: ti.template(), albedo, normal, toward_eye, lit, open_share):
    """Linear light that a matt surface sends to the eye, with a highlight and a rim."""
    sun = ti.Vector([stage[0], stage[1], stage[2]])
    facing = normal.dot(sun)
    diffuse = ti.max((facing + 0.15) / 1.15, 0.0) * lit
    up = 0.5 + 0.5 * normal[1]
    half = (sun + toward_eye).normalized()
    shine = stage[SHINE] * ti.pow(ti.max(normal.dot(half), 0.0), 36.0) * lit
    edge = 1.0 - ti.max(normal.dot(toward_eye), 0.0)
    rim = stage[RIM] * edge * edge * edge * open_share
    color = ti.Vector([0.0, 0.0, 0.0])
    for c in ti.static(range(3)):
        ambient = stage[9 + c] + (stage[6 + c] - stage[9 + c]) * up
        color[c] = albedo[c] * (stage[3 + c] * diffuse + ambient * open_share)
        color[c] += stage[3 + c] * shine + stage[6 + c] * rim
    return color


@ti.func
def triangle_surface(position: ti.template(), normal: ti.template(), triangles: ti.template(), n, p):
    """Normal and barycentric coordinates at world point `p` of triangle `n`.

    A vertex whose normal leaves the triangle's by more than CREASE, or has none, counts as flat there.
    """
    a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
    pa = ti.Vector([position[a, k] for k in ti.static(range(3))])
    pb = ti.Vector([position[b, k] for k in ti.static(range(3))])
    pc = ti.Vector([position[c, k] for k in ti.static(range(3))])
    across = (pb - pa).cross(pc - pa)
    area = ti.max(across.dot(across), 1e-36)
    share_b = ti.min(ti.max((p - pa).cross(pc - pa).dot(across) / area, 0.0), 1.0)
    share_c = ti.min(ti.max((pb - pa).cross(p - pa).dot(across) / area, 0.0), 1.0)
    share = ti.Vector([ti.max(1.0 - share_b - share_c, 0.0), share_b, share_c])
    flat = across / ti.sqrt(area)
    smooth = ti.Vector([0.0, 0.0, 0.0])
    for k in ti.static(range(3)):
        corner = ti.Vector([normal[triangles[n, k], d] for d in ti.static(range(3))])
        agrees = corner.dot(flat)
        smooth += share[k] * ti.select(
            ti.abs(agrees) < CREASE, flat, ti.select(agrees < 0.0, -corner, corner)
        )
    return (smooth + 1e-6 * flat).normalized(), flat, share


@ti.func
def line_normal(camera: ti.template(), a, b, x, y, radius):
    """World normal of a round stick between view points `a` and `b` at a pixel."""
    sa, sb = to_screen(camera, clipped(camera, a, b)), to_screen(camera, clipped(camera, b, a))
    t, distance = along_segment(sa, sb, x, y)
    w = sa[3] + (sb[3] - sa[3]) * t
    q = ti.min(distance / ti.max(radius * camera[FOCAL] / w, 0.5), 0.999)
    dx, dy = x - (sa[0] + t * (sb[0] - sa[0])), y - (sa[1] + t * (sb[1] - sa[1]))
    side = ti.Vector([dx, -dy]) * (q / ti.max(distance, 1e-6))
    return across_view(camera, side[0], side[1], ti.sqrt(1.0 - q * q))


@ti.func
def across_view(camera: ti.template(), right, up, back):
    """World direction of view components; `back` points at the camera."""
    return ti.Vector(
        [camera[3 + c] * right + camera[6 + c] * up - camera[9 + c] * back for c in ti.static(range(3))]
    )


@ti.kernel
def resolve(
    out: u8_3d,
    key: i64_2d,
    camera: f32_1d,
    stage: f32_1d,
    fog: f32_1d,
    background: f32_3d,
    shade: f32_3d,
    depth: f32_2d,
    reach: ti.f32,
    light: i64_3d,
    light_scale: ti.f32,
    sphere_position: f32_2d,
    sphere_radius: f32_1d,
    sphere_tone: f32_1d,
    position: f32_2d,
    normal: f32_2d,
    triangles: i32_2d,
    tone: f32_1d,
    tint: f32_1d,
    line_position: f32_2d,
    segments: i32_2d,
    line_radius: f32_1d,
    line_tone: f32_1d,
    colors: f32_2d,
    encoding: f32_1d,
):
    """The picture (height, width, 3) uint8: surfaces lit and fogged, blended light over them, encoded.

    Ids run through spheres, triangles, lines. `tone` is a row of `colors` (linear light); the back
    of a triangle takes the row 256 further on. `shade` and `depth` are read only where the
    stage has shadows or corners. `tint` brightens, above 1.5 towards white.
    """
    height, width = out.shape[0], out.shape[1]
    samples = key.shape[0] // height
    first_triangle = sphere_position.shape[0]
    first_line = first_triangle + triangles.shape[0]
    for y, x in ti.ndrange(height, width):
        behind = ti.Vector([background[y, x, c] for c in ti.static(range(3))])
        total = ti.Vector([0.0, 0.0, 0.0])
        color = behind
        last = -2
        for k in range(samples * samples):
            ky, kx = y * samples + k // samples, x * samples + k % samples
            found = key[ky, kx]
            n = ti.cast(found & ti.i64(LOW_WORD), ti.i32)
            if found == ti.i64(EMPTY):
                n = -1
            if n != last:
                last = n
                px, py = kx + 0.5, ky + 0.5
                z = depth_of(found)
                if n == -1:
                    z = floor_depth(camera, stage, px, py)
                enclosed, lit = 0.0, 1.0
                if stage[SHADOW] + stage[CORNER] > 0.0 and z < FAR * 0.5:
                    enclosed, lit = averaged_shade(shade, depth, reach, x, y, z)
                open_share = 1.0 - stage[CORNER] * enclosed
                lit = 1.0 - stage[SHADOW] * (1.0 - lit)
                if n == -1:
                    color = behind * (0.4 + 0.6 * lit) * open_share
                else:
                    view = ray(camera, px, py)
                    toward_eye = across_view(camera, -view[0], -view[1], 1.0)
                    if camera[PERSPECTIVE] < 0.5:
                        toward_eye = across_view(camera, 0.0, 0.0, 1.0)
                    toward_eye = toward_eye.normalized()
                    facing = ti.Vector([0.0, 1.0, 0.0])
                    row = 0
                    bright = 1.0
                    if n < first_triangle:
                        center = ti.Vector([sphere_position[n, c] for c in ti.static(range(3))])
                        v = to_view(camera, center[0], center[1], center[2])
                        s = to_screen(camera, v)
                        r = ti.max(sphere_radius[n] * camera[FOCAL] / s[3], 0.5)
                        nx, ny = (px - s[0]) / r, (s[1] - py) / r
                        facing = across_view(camera, nx, ny, ti.sqrt(ti.max(1.0 - nx * nx - ny * ny, 0.01)))
                        row = ti.cast(sphere_tone[n], ti.i32)
                    elif n < first_line:
                        m = n - first_triangle
                        p = to_world(camera, px, py, z)
                        smooth, flat, share = triangle_surface(position, normal, triangles, m, p)
                        back = flat.dot(toward_eye) < 0.0
                        facing = ti.select(back, -smooth, smooth)
                        blended = 0.0
                        bright = 0.0
                        for c in ti.static(range(3)):
                            blended += share[c] * tone[triangles[m, c]]
                            bright += share[c] * tint[triangles[m, c]]
                        row = ti.cast(blended, ti.i32) + ti.select(back, 256, 0)
                    else:
                        m = n - first_line
                        a, b = segments[m, 0], segments[m, 1]
                        va = to_view(camera, line_position[a, 0], line_position[a, 1], line_position[a, 2])
                        vb = to_view(camera, line_position[b, 0], line_position[b, 1], line_position[b, 2])
                        facing = line_normal(camera, va, vb, px, py, line_radius[m])
                        row = ti.cast(line_tone[m], ti.i32)
                    white = ti.max(bright - 1.5, 0.0) * 0.5
                    bright = ti.min(bright, 1.5)
                    albedo = ti.Vector([colors[row, c] * bright + white for c in ti.static(range(3))])
                    surface = lit_color(stage, albedo, facing.normalized(), toward_eye, lit, open_share)
                    color = behind + (surface - behind) * faded(fog, z)
            total += color
        total /= samples * samples
        red_green, blue_depth = light[y, x, 0], light[y, x, 1]
        optical = ti.cast(blue_depth & ti.i64(LOW_WORD), ti.f32) / light_scale
        through = ti.exp(-optical)
        gain = ti.select(optical > 1e-4, (1.0 - through) / ti.max(optical, 1e-4), 1.0) / light_scale
        total = total * through
        total[0] += ti.cast(red_green >> 32, ti.f32) * gain
        total[1] += ti.cast(red_green & ti.i64(LOW_WORD), ti.f32) * gain
        total[2] += ti.cast(blue_depth >> 32, ti.f32) * gain
        # Half a step of fixed noise hides the bands of smooth gradients.
        dither = noise(x, y) - 0.5
        for c in ti.static(range(3)):
            place = ti.min(ti.sqrt(ti.max(total[c], 0.0)) * ENCODING_STEPS, ENCODING_SIZE - 1.0)
            value = encoding[ti.cast(place, ti.i32)] + 0.5 + 0.9 * dither
            out[y, x, c] = ti.cast(ti.min(ti.max(value, 0.0), 255.0), ti.u8)
