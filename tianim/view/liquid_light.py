"""Light of liquids: what they mirror, what is seen through them, and what their body sends back.

The light behind is looked up in the picture of all that is solid, where the ray leaves that was bent at the
front and again at the back; far aside the surroundings stand in for it. Limits: what is mirrored are
the surroundings only, not the scene; what lies outside the picture cannot be seen through the liquid.

front and thickness as in `liquid`; pictures (height, width, 3) are linear light; a substance is the row
of `material.Substance`.
"""

from tianim.lang import f32_1d, f32_2d, f32_3d, ti, u8_3d
from tianim.view.environment import mirrored_light
from tianim.view.layout import faded, i64_3d, to_screen, to_view, to_world
from tianim.view.shade import encode, through_light, to_eye

SURE, ASTRAY = 0.93, 0.6  # cosine of a ray's turn up to which the picture tells what is there, and from
# which on the surroundings do
BRIGHTEST = 1.6  # most light that is mirrored: a bright pixel on an edge would flicker
BRIGHTEST_BEHIND = 0.8  # most light that is seen through a liquid from beside the picture
FURTHEST = 0.16  # of the height: how far from its pixel the light behind is looked up
SPARKLE = 25.0  # the larger, the fainter the sun's own highlight beside its softbox

# Columns of the row of a substance.
SIGMA, BODY, GLOW, REFRACTION, ROUGH, EMISSION = 0, 3, 6, 9, 10, 11


@ti.func
def fresnel(cosine, refraction):
    """Share of light mirrored at an angle (Schlick 1994)."""
    head_on = ((refraction - 1.0) / (refraction + 1.0)) ** 2
    away = 1.0 - ti.min(ti.max(cosine, 0.0), 1.0)
    return head_on + (1.0 - head_on) * away**5


@ti.func
def left_over(substance: ti.template(), way):
    """Share of each colour that is left after `way` [m] (Beer-Lambert)."""
    return ti.Vector([ti.exp(-substance[SIGMA + c] * ti.max(way, 0.0)) for c in ti.static(range(3))])


@ti.func
def bent(ahead, normal, ratio):
    """Direction of a ray behind a surface with `normal` towards it; mirrored where none gets through.

    `ratio`: refractive index before the surface over that behind it.
    """
    cosine = ti.min(ti.max(-normal.dot(ahead), 0.0), 1.0)
    square = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
    out = ahead + 2.0 * cosine * normal
    if square > 0.0:
        out = ratio * ahead + (ratio * cosine - ti.sqrt(square)) * normal
    return out.normalized()


@ti.func
def picked(picture: ti.template(), x, y):
    """Light of a picture at pixel coordinates, between its pixels."""
    height, width = picture.shape[0], picture.shape[1]
    px = ti.min(ti.max(x - 0.5, 0.0), width - 1.001)
    py = ti.min(ti.max(y - 0.5, 0.0), height - 1.001)
    x0, y0 = ti.cast(px, ti.i32), ti.cast(py, ti.i32)
    fx, fy = px - x0, py - y0
    light = ti.Vector([0.0, 0.0, 0.0])
    for c in ti.static(range(3)):
        upper = picture[y0, x0, c] * (1.0 - fx) + picture[y0, x0 + 1, c] * fx
        lower = picture[y0 + 1, x0, c] * (1.0 - fx) + picture[y0 + 1, x0 + 1, c] * fx
        light[c] = upper * (1.0 - fy) + lower * fy
    return light


@ti.func
def back_normal(camera: ti.template(), front: ti.template(), thickness: ti.template(), x, y, toward_eye):
    """Normal of the back of a liquid, towards the eye, from the depths two pixels to each side."""
    height, width = thickness.shape[0], thickness.shape[1]
    ends = ti.Matrix.zero(ti.f32, 4, 3)
    for k in ti.static(range(4)):
        sx = ti.min(ti.max(x + 2 * (k == 1) - 2 * (k == 0), 0), width - 1)
        sy = ti.min(ti.max(y + 2 * (k == 3) - 2 * (k == 2), 0), height - 1)
        if front[sy, sx, 0] <= 0.0:
            sx, sy = x, y
        p = to_world(camera, sx + 0.5, sy + 0.5, front[sy, sx, 1] + thickness[sy, sx])
        for c in ti.static(range(3)):
            ends[k, c] = p[c]
    across = ti.Vector([ends[1, c] - ends[0, c] for c in ti.static(range(3))])
    down = ti.Vector([ends[3, c] - ends[2, c] for c in ti.static(range(3))])
    n = down.cross(across)
    length = n.norm()
    n = ti.select(length > 1e-20, n / ti.max(length, 1e-20), toward_eye)
    return ti.select(n.dot(toward_eye) < 0.0, -n, n)


@ti.func
def light_behind(
    picture: ti.template(), depth: ti.template(), camera: ti.template(), leaving, ahead, x, y, z, gap
):
    """Light that comes to point `leaving` from `ahead`: of what lies `gap` [m] further.

    What lies before depth `z` is no background: there the straight view stands in.
    """
    height, width = picture.shape[0], picture.shape[1]
    p = leaving + ahead * gap
    s = to_screen(camera, to_view(camera, p[0], p[1], p[2]))
    dx, dy = s[0] - (x + 0.5), s[1] - (y + 0.5)
    length, most = ti.sqrt(dx * dx + dy * dy), FURTHEST * height
    # Bends softly to the furthest place, so that no edge shows there.
    scale = most / (most + length)
    sx, sy = x + 0.5 + dx * scale, y + 0.5 + dy * scale
    sx, sy = ti.abs(sx), ti.abs(sy)  # mirrored at the edges of the picture
    sx = ti.select(sx > width, 2.0 * width - sx, sx)
    sy = ti.select(sy > height, 2.0 * height - sy, sy)
    px = ti.min(ti.max(ti.cast(sx, ti.i32), 0), width - 1)
    py = ti.min(ti.max(ti.cast(sy, ti.i32), 0), height - 1)
    if depth[py, px] < z:
        sx, sy = x + 0.5, y + 0.5
    return picked(picture, sx, sy)


@ti.func
def highlight(stage: ti.template(), normal, toward_eye, roughness, refraction):
    """Light of the sun that a surface mirrors to the eye."""
    sun = ti.Vector([stage[0], stage[1], stage[2]])
    half = (sun + toward_eye).normalized()
    power = ti.min(ti.max(2.0 / ti.max(roughness * roughness * roughness * roughness, 1e-9), 6.0), 900.0)
    lobe = ti.pow(ti.max(normal.dot(half), 0.0), power) * (power + 8.0) / SPARKLE
    return lobe * fresnel(half.dot(toward_eye), refraction) * ti.max(normal.dot(sun), 0.0)


@ti.func
def body_light(stage: ti.template(), substance: ti.template(), normal, toward_eye, left):
    """Light that the body of a liquid sends back, and its own, where `left` of the light gets through it."""
    sun = ti.Vector([stage[0], stage[1], stage[2]])
    facing = 0.35 + 0.65 * ti.max(normal.dot(sun), 0.0)
    up = 0.5 + 0.5 * normal[1]
    lost = 1.0 - (left[0] + left[1] + left[2]) / 3.0
    hot = substance[EMISSION] * ti.max(normal.dot(toward_eye), 0.0) ** 2  # a crust darkens the edge
    light = ti.Vector([0.0, 0.0, 0.0])
    for c in ti.static(range(3)):
        around = stage[9 + c] + (stage[6 + c] - stage[9 + c]) * up
        light[c] = substance[BODY + c] * (stage[3 + c] * facing + around) * lost
        light[c] += hot * substance[GLOW + c] * lost
    return light


@ti.kernel
def compose(
    out: f32_3d, picture: f32_3d, front: f32_3d, thickness: f32_2d, depth: f32_2d, camera: f32_1d,
    stage: f32_1d, fog: f32_1d, background: f32_3d, mirror: f32_3d, substance: f32_1d, farthest: ti.f32,
):  # fmt: skip
    """The picture with the liquid in it; `farthest` [m]: where the background is taken to stand."""
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        color = ti.Vector([picture[y, x, c] for c in ti.static(range(3))])
        cover = front[y, x, 0]
        if cover > 0.0:
            z, thick = front[y, x, 1], thickness[y, x]
            normal = ti.Vector([front[y, x, 2 + c] for c in ti.static(range(3))])
            toward_eye = to_eye(camera, x + 0.5, y + 0.5)
            index, rough = substance[REFRACTION], substance[ROUGH]
            p = to_world(camera, x + 0.5, y + 0.5, z)
            slant = 1.0 / ti.max(
                -(toward_eye[0] * camera[9] + toward_eye[1] * camera[10] + toward_eye[2] * camera[11]), 0.1
            )
            way = thick * slant
            inside = bent(-toward_eye, normal, 1.0 / index)
            back = back_normal(camera, front, thickness, x, y, toward_eye)
            ahead = bent(inside, back, index)
            gap = (ti.min(depth[y, x], farthest) - z - thick) * slant
            behind = light_behind(picture, depth, camera, p + inside * way, ahead, x, y, z, ti.max(gap, 0.0))
            # Far aside the picture tells little: what surrounds it is seen there.
            astray = ti.min(ti.max((SURE + ahead.dot(toward_eye)) / (SURE - ASTRAY), 0.0), 1.0)
            astray *= ti.max(gap, 0.0) / ti.max(gap + way, 1e-12)  # what it touches is seen where it is
            around = ti.min(mirrored_light(mirror, camera, ahead, ti.max(rough, 0.15)), BRIGHTEST_BEHIND)
            behind += (around - behind) * astray
            left = left_over(substance, way)
            share = fresnel(normal.dot(toward_eye), index) * (1.0 - 0.7 * rough)
            aside = 2.0 * normal.dot(toward_eye) * normal - toward_eye
            mirrored = mirrored_light(mirror, camera, aside, rough)
            glint = highlight(stage, normal, toward_eye, rough, index)
            body = body_light(stage, substance, normal, toward_eye, left)
            through = ti.Vector([0.0, 0.0, 0.0])
            for c in ti.static(range(3)):
                through[c] = (1.0 - share) * (behind[c] * left[c] + body[c])
                through[c] += ti.min(share * mirrored[c] + glint * stage[3 + c], BRIGHTEST)
                far_off = background[y, x, c]
                through[c] = far_off + (through[c] - far_off) * faded(fog, z)
            color += (through - color) * cover
        for c in ti.static(range(3)):
            out[y, x, c] = color[c]


@ti.kernel
def finish(out: u8_3d, picture: f32_3d, light: i64_3d, light_scale: ti.f32, encoding: f32_1d):
    """Bytes of a picture with the blended items before it."""
    for y, x in ti.ndrange(out.shape[0], out.shape[1]):
        behind = ti.Vector([picture[y, x, c] for c in ti.static(range(3))])
        encode(out, encoding, y, x, through_light(light, light_scale, y, x, behind))
