"""Shading kernels: light, shadow, corners and fog for what the raster kernels found to be visible.

The colour of a sample is worked out once per primitive and pixel: where all samples of a pixel
show the same primitive, one stands for all. Colours are linear light until the last line.
"""

from tianim.lang import f32_1d, f32_2d, f32_3d, i32_2d, i64_2d, ti, u8_3d
from tianim.view.colormap import ENTRIES
from tianim.view.layout import (
    CORNER,
    FAR,
    FOCAL,
    LOW_WORD,
    PERSPECTIVE,
    RIM,
    SHADOW,
    SHINE,
    across_view,
    along_segment,
    clipped,
    depth_of,
    faded,
    i64_3d,
    ray,
    to_screen,
    to_view,
    to_world,
)
from tianim.view.shadow import averaged_shade, floor_depth, noise

ENCODING_STEPS = 1024.0  # entries of the encoding table for each unit of the root of light
ENCODING_SIZE = 4096
NOTHING = -1  # id where a sample shows no primitive
CREASE = 0.72  # cosine of the angle from which an edge is drawn sharp


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
def line_normal(camera: ti.template(), position: ti.template(), segments: ti.template(), m, radius, x, y):
    """World normal of the round stick `m` at a pixel."""
    a, b = segments[m, 0], segments[m, 1]
    va = to_view(camera, position[a, 0], position[a, 1], position[a, 2])
    vb = to_view(camera, position[b, 0], position[b, 1], position[b, 2])
    sa, sb = to_screen(camera, clipped(camera, va, vb)), to_screen(camera, clipped(camera, vb, va))
    t, distance = along_segment(sa, sb, x, y)
    w = sa[3] + (sb[3] - sa[3]) * t
    q = ti.min(distance / ti.max(radius * camera[FOCAL] / w, 0.5), 0.999)
    dx, dy = x - (sa[0] + t * (sb[0] - sa[0])), y - (sa[1] + t * (sb[1] - sa[1]))
    side = ti.Vector([dx, -dy]) * (q / ti.max(distance, 1e-6))
    return across_view(camera, side[0], side[1], ti.sqrt(1.0 - q * q))


@ti.func
def sphere_normal(camera: ti.template(), position: ti.template(), n, radius, x, y):
    """World normal of sphere `n` at a pixel of its disc."""
    s = to_screen(camera, to_view(camera, position[n, 0], position[n, 1], position[n, 2]))
    r = ti.max(radius * camera[FOCAL] / s[3], 0.5)
    nx, ny = (x - s[0]) / r, (s[1] - y) / r
    return across_view(camera, nx, ny, ti.sqrt(ti.max(1.0 - nx * nx - ny * ny, 0.01)))


@ti.func
def primitive(found):
    """Id in a key; NOTHING where it is EMPTY, whose low word has all bits set."""
    return ti.cast(found & ti.i64(LOW_WORD), ti.i32)


@ti.func
def to_eye(camera: ti.template(), x, y):
    """World direction from what a pixel shows to the camera."""
    r = ray(camera, x, y)
    sideways = ti.select(camera[PERSPECTIVE] > 0.5, 1.0, 0.0)
    return across_view(camera, -r[0] * sideways, -r[1] * sideways, 1.0).normalized()


@ti.func
def through_light(light: ti.template(), scale, y, x, behind):
    """Linear light of a pixel seen through the blended items over it."""
    red_green, blue_depth = light[y, x, 0], light[y, x, 1]
    optical = ti.cast(blue_depth & ti.i64(LOW_WORD), ti.f32) / scale
    left = ti.exp(-optical)
    gain = ti.select(optical > 1e-4, (1.0 - left) / ti.max(optical, 1e-4), 1.0) / scale
    red, green = ti.cast(red_green >> 32, ti.f32), ti.cast(red_green & ti.i64(LOW_WORD), ti.f32)
    return behind * left + ti.Vector([red, green, ti.cast(blue_depth >> 32, ti.f32)]) * gain


@ti.func
def mesh_surface(
    camera: ti.template(), position: ti.template(), normal: ti.template(), triangles: ti.template(),
    tone: ti.template(), tint: ti.template(), m, x, y, z, toward_eye,
):  # fmt: skip
    """Normal towards the eye, row of the colour table and tint of triangle `m` at a pixel and depth `z`."""
    p = to_world(camera, x, y, z)
    smooth, flat, share = triangle_surface(position, normal, triangles, m, p)
    back = flat.dot(toward_eye) < 0.0
    row, bright = 0.0, 0.0
    for c in ti.static(range(3)):
        row += share[c] * tone[triangles[m, c]]
        bright += share[c] * tint[triangles[m, c]]
    return (
        ti.select(back, -smooth, smooth),
        ti.cast(row, ti.i32) + ti.select(back, ENTRIES, 0),
        bright,
    )


@ti.func
def tinted(colors: ti.template(), row, bright):
    """A row of the colour table, brightened; above 1.5 it goes towards white instead."""
    white = ti.max(bright - 1.5, 0.0) * 0.5
    bright = ti.min(bright, 1.5)
    return ti.Vector([colors[row, c] * bright + white for c in ti.static(range(3))])


@ti.func
def light_reaching(stage: ti.template(), shade: ti.template(), depth: ti.template(), reach, x, y, z):
    """Shares of the key light, and of the light from all round, that reach a pixel at depth `z`."""
    enclosed, lit = 0.0, 1.0
    if stage[SHADOW] + stage[CORNER] > 0.0 and z < FAR * 0.5:
        enclosed, lit = averaged_shade(shade, depth, reach, x, y, z)
    return 1.0 - stage[SHADOW] * (1.0 - lit), 1.0 - stage[CORNER] * enclosed


@ti.func
def encode(out: ti.template(), encoding: ti.template(), y, x, color):
    """Write linear light as bytes; half a step of fixed noise hides the bands of smooth gradients."""
    dither = noise(x, y) - 0.5
    for c in ti.static(range(3)):
        place = ti.min(ti.sqrt(ti.max(color[c], 0.0)) * ENCODING_STEPS, ENCODING_SIZE - 1.0)
        value = encoding[ti.cast(place, ti.i32)] + 0.5 + 0.9 * dither
        out[y, x, c] = ti.cast(ti.min(ti.max(value, 0.0), 255.0), ti.u8)


@ti.kernel
def resolve(
    out: u8_3d, key: i64_2d, camera: f32_1d, stage: f32_1d, fog: f32_1d, background: f32_3d,
    shade: f32_3d, depth: f32_2d, reach: ti.f32, light: i64_3d, light_scale: ti.f32,
    sphere_position: f32_2d, sphere_radius: f32_1d, sphere_tone: f32_1d,
    position: f32_2d, normal: f32_2d, triangles: i32_2d, tone: f32_1d, tint: f32_1d,
    line_position: f32_2d, segments: i32_2d, line_radius: f32_1d, line_tone: f32_1d,
    colors: f32_2d, encoding: f32_1d, linear: f32_3d,
):  # fmt: skip
    """The picture (height, width, 3) uint8: surfaces lit and fogged, blended light over them, encoded.

    Ids run through spheres, triangles, lines. `tone` is a row of `colors` (linear light); the back
    of a triangle takes the row ENTRIES further on. `shade` and `depth` are read only where the
    stage has shadows or corners. `linear` of the picture's size takes its linear light.
    """
    height, width = out.shape[0], out.shape[1]
    samples = key.shape[0] // height
    first_triangle = sphere_position.shape[0]
    first_line = first_triangle + triangles.shape[0]
    for y, x in ti.ndrange(height, width):
        behind = ti.Vector([background[y, x, c] for c in ti.static(range(3))])
        total = ti.Vector([0.0, 0.0, 0.0])
        color = behind
        last = NOTHING - 1  # no primitive yet
        for k in range(samples * samples):
            ky, kx = y * samples + k // samples, x * samples + k % samples
            n = primitive(key[ky, kx])
            if n != last:
                last = n
                px, py = kx + 0.5, ky + 0.5
                z = depth_of(key[ky, kx])
                if n == NOTHING:
                    z = floor_depth(camera, stage, px, py)
                lit, open_share = light_reaching(stage, shade, depth, reach, x, y, z)
                if n == NOTHING:
                    color = behind * (0.4 + 0.6 * lit) * open_share
                else:
                    toward_eye = to_eye(camera, px, py)
                    facing, row, bright = ti.Vector([0.0, 1.0, 0.0]), 0, 1.0
                    if n < first_triangle:
                        facing = sphere_normal(camera, sphere_position, n, sphere_radius[n], px, py)
                        row = ti.cast(sphere_tone[n], ti.i32)
                    elif n < first_line:
                        facing, row, bright = mesh_surface(
                            camera, position, normal, triangles, tone, tint, n - first_triangle,
                            px, py, z, toward_eye,
                        )  # fmt: skip
                    else:
                        m = n - first_line
                        facing = line_normal(camera, line_position, segments, m, line_radius[m], px, py)
                        row = ti.cast(line_tone[m], ti.i32)
                    albedo = tinted(colors, row, bright)
                    surface = lit_color(stage, albedo, facing.normalized(), toward_eye, lit, open_share)
                    color = behind + (surface - behind) * faded(fog, z)
            total += color
        shown = through_light(light, light_scale, y, x, total / (samples * samples))
        if linear.shape[0] == height:
            for c in ti.static(range(3)):
                linear[y, x, c] = shown[c]
        encode(out, encoding, y, x, shown)
