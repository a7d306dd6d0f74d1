"""Visibility kernels: which primitive is seen at each sample, and where light is blended.

Spheres, triangles and thick lines compete for each sample of a key buffer by a 64-bit atomic
minimum of (depth bits << 32 | primitive id): the nearest wins, ties go to the smaller id, and the
picture is the same for any number of threads. A translucent or tiny item is not depth sorted:
`blend_capsules` adds its optical depth and colour in fixed point, so that order cannot matter.

Arrays: key (height * samples, width * samples) int64 and camera as in `layout`; points (n, 3)
float32 [m].
"""

from tianim.lang import f32_1d, f32_2d, f32_3d, i32_2d, i64_2d, ti
from tianim.view.layout import (
    FOCAL,
    HEIGHT,
    MAX_PIXEL,
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

MIN_RADIUS = 0.7072  # [samples]: a smaller disc can lie between the sample centres
MOST_HIDDEN = 0.98  # opacity of one blended item, where its optical depth must stay finite


@ti.func
def offer(key: ti.template(), x, y, depth, identity):
    """Let primitive `identity` at `depth` compete for sample (x, y)."""
    candidate = (ti.cast(ti.bit_cast(depth, ti.i32), ti.i64) << 32) | ti.cast(identity, ti.i64)
    if candidate < key[y, x]:
        ti.atomic_min(key[y, x], candidate)


@ti.kernel
def raster_spheres(key: i64_2d, camera: f32_1d, position: f32_2d, radius: f32_1d, first: ti.i32):
    """Spheres as discs with the depth of a ball; ids from `first`."""
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    for n in range(position.shape[0]):
        v = to_view(camera, position[n, 0], position[n, 1], position[n, 2])
        if v[2] > camera[NEAR]:
            s = to_screen(camera, v)
            r = ti.min(ti.max(radius[n] * camera[FOCAL] / s[3], MIN_RADIUS), MAX_PIXEL)
            x0, x1 = (
                ti.max(0, ti.cast(ti.floor(s[0] - r), ti.i32)),
                ti.min(width, ti.cast(s[0] + r, ti.i32) + 1),
            )
            y0, y1 = (
                ti.max(0, ti.cast(ti.floor(s[1] - r), ti.i32)),
                ti.min(height, ti.cast(s[1] + r, ti.i32) + 1),
            )
            front = ti.bit_cast(ti.max(s[2] - radius[n], camera[NEAR]), ti.i32)
            for y in range(y0, y1):
                dy = (y + 0.5 - s[1]) / r
                half = r * ti.sqrt(ti.max(1.0 - dy * dy, 0.0)) + 0.01  # of the row, and what rounding may add
                xa = ti.max(x0, ti.cast(ti.ceil(s[0] - half - 0.5), ti.i32))
                xb = ti.min(x1, ti.cast(ti.floor(s[0] + half - 0.5), ti.i32) + 1)
                for x in range(xa, xb):
                    dx = (x + 0.5 - s[0]) / r
                    inside = 1.0 - dx * dx - dy * dy
                    if inside >= 0.0 and front <= ti.cast(key[y, x] >> 32, ti.i32):
                        depth = ti.max(s[2] - radius[n] * ti.sqrt(inside), camera[NEAR])
                        offer(key, x, y, depth, first + n)


@ti.kernel
def raster_triangles(key: i64_2d, camera: f32_1d, position: f32_2d, triangles: i32_2d, first: ti.i32):
    """Triangles, seen from both sides; of one that crosses the plane of the camera, what is in front.

    Edge functions in homogeneous coordinates (Olano and Greer 1997), taken from a corner of the
    triangle's own box, where float32 is exact enough for triangles of a pixel.
    """
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    for n in range(triangles.shape[0]):
        a, b, c = triangles[n, 0], triangles[n, 1], triangles[n, 2]
        va = to_view(camera, position[a, 0], position[a, 1], position[a, 2])
        vb = to_view(camera, position[b, 0], position[b, 1], position[b, 2])
        vc = to_view(camera, position[c, 0], position[c, 1], position[c, 2])
        nearest, farthest = ti.min(va[2], vb[2], vc[2]), ti.max(va[2], vb[2], vc[2])
        if farthest > camera[NEAR]:
            sa, sb, sc = to_screen(camera, va), to_screen(camera, vb), to_screen(camera, vc)
            x0, x1, y0, y1 = 0, width, 0, height
            if nearest > camera[NEAR]:
                x0 = ti.max(0, ti.cast(ti.floor(ti.min(sa[0], sb[0], sc[0])), ti.i32))
                x1 = ti.min(width, ti.cast(ti.max(sa[0], sb[0], sc[0]), ti.i32) + 1)
                y0 = ti.max(0, ti.cast(ti.floor(ti.min(sa[1], sb[1], sc[1])), ti.i32))
                y1 = ti.min(height, ti.cast(ti.max(sa[1], sb[1], sc[1]), ti.i32) + 1)
            perspective = camera[PERSPECTIVE] > 0.5
            ox, oy = 0.5 * width - x0, 0.5 * height - y0
            wa = ti.select(perspective, va[2], 1.0)
            wb = ti.select(perspective, vb[2], 1.0)
            wc = ti.select(perspective, vc[2], 1.0)
            f = camera[FOCAL]
            pa = ti.Vector([va[0] * f + ox * wa, oy * wa - va[1] * f, wa])
            pb = ti.Vector([vb[0] * f + ox * wb, oy * wb - vb[1] * f, wb])
            pc = ti.Vector([vc[0] * f + ox * wc, oy * wc - vc[1] * f, wc])
            ea, eb, ec = pb.cross(pc), pc.cross(pa), pa.cross(pb)
            area = pa.dot(ea)
            if ti.abs(area) > 1e-30:
                ea, eb, ec = ea / area, eb / area, ec / area
                for y in range(y0, y1):
                    py = y - y0 + 0.5
                    ra, rb, rc = ea[1] * py + ea[2], eb[1] * py + eb[2], ec[1] * py + ec[2]
                    for x in range(x0, x1):
                        px = x - x0 + 0.5
                        ba, bb, bc = ea[0] * px + ra, eb[0] * px + rb, ec[0] * px + rc
                        if ti.min(ba, bb, bc) >= 0.0:
                            depth = (ba * va[2] + bb * vb[2] + bc * vc[2]) / (ba + bb + bc)
                            if depth > camera[NEAR]:
                                offer(key, x, y, depth, first + n)


@ti.func
def depth_along(camera: ti.template(), za, zb, t):
    """Depth at the screen parameter `t` between two depths."""
    linear = za + (zb - za) * t
    return ti.select(camera[PERSPECTIVE] > 0.5, za * zb / ti.max(zb + (za - zb) * t, 1e-12), linear)


@ti.kernel
def raster_lines(
    key: i64_2d, camera: f32_1d, position: f32_2d, segments: i32_2d, radius: f32_1d, first: ti.i32
):
    """Segments as round sticks, `radius` [m] per segment."""
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    for n in range(segments.shape[0]):
        a, b = segments[n, 0], segments[n, 1]
        va = to_view(camera, position[a, 0], position[a, 1], position[a, 2])
        vb = to_view(camera, position[b, 0], position[b, 1], position[b, 2])
        if ti.max(va[2], vb[2]) > camera[NEAR] * 1.01:
            sa, sb = to_screen(camera, clipped(camera, va, vb)), to_screen(camera, clipped(camera, vb, va))
            ra = ti.min(ti.max(radius[n] * camera[FOCAL] / sa[3], MIN_RADIUS), MAX_PIXEL)
            rb = ti.min(ti.max(radius[n] * camera[FOCAL] / sb[3], MIN_RADIUS), MAX_PIXEL)
            r = ti.max(ra, rb)
            # Rows of the box, and in each only the columns that the stick can reach.
            y0 = ti.max(0, ti.cast(ti.floor(ti.min(sa[1], sb[1]) - r), ti.i32))
            y1 = ti.min(height, ti.cast(ti.max(sa[1], sb[1]) + r, ti.i32) + 1)
            low, high = ti.min(sa[0], sb[0]), ti.max(sa[0], sb[0])
            slope = (sb[0] - sa[0]) / ti.select(ti.abs(sb[1] - sa[1]) > 1e-3, sb[1] - sa[1], 1e-3)
            reach = r * (1.0 + ti.abs(slope)) + 1.0
            for y in range(y0, y1):
                middle = sa[0] + slope * (y + 0.5 - sa[1])
                x0 = ti.max(0, ti.cast(ti.floor(ti.max(low - r, middle - reach)), ti.i32))
                x1 = ti.min(width, ti.cast(ti.min(high + r, middle + reach), ti.i32) + 1)
                for x in range(x0, x1):
                    t, distance = along_segment(sa, sb, x + 0.5, y + 0.5)
                    here = ra + (rb - ra) * t
                    if distance <= here:
                        q = distance / here
                        depth = depth_along(camera, sa[2], sb[2], t) - radius[n] * ti.sqrt(1.0 - q * q)
                        offer(key, x, y, ti.max(depth, camera[NEAR]), first + n)


@ti.func
def share_between(sa, sb, length, x, y):
    """Share of a pixel between the two straight ends of a screen segment."""
    along = ((x - sa[0]) * (sb[0] - sa[0]) + (y - sa[1]) * (sb[1] - sa[1])) / ti.max(length, 1e-6)
    return ti.min(ti.max(along + 0.5, 0.0), 1.0) * ti.min(ti.max(length - along + 0.5, 0.0), 1.0)


@ti.kernel
def blend_capsules(
    light: i64_3d,
    key: i64_2d,
    camera: f32_1d,
    fog: f32_1d,
    background: f32_3d,
    tail: f32_2d,
    head: f32_2d,
    radius: f32_1d,
    opacity: f32_1d,
    tone: f32_1d,
    colors: f32_2d,
    taper: ti.f32,
    joined: ti.i32,
    glow: ti.f32,
    scale: ti.f32,
):
    """Add sticks from `tail` to `head` with smooth edges, thinned to `taper` at the tail.

    light (height, width, 2) holds red << 32 | green and blue << 32 | optical depth, in units of
    1 / scale. What is thinner than a pixel is drawn a pixel wide and as much more transparent.
    `glow` 0: they hide what is behind; else they add light of this strength and hide nothing.
    `joined` 1: ends are cut straight, so that the sticks of a trail do not overlap.
    """
    width, height = ti.cast(camera[WIDTH], ti.i32), ti.cast(camera[HEIGHT], ti.i32)
    samples = key.shape[1] // width
    for n in range(tail.shape[0]):
        va = to_view(camera, tail[n, 0], tail[n, 1], tail[n, 2])
        vb = to_view(camera, head[n, 0], head[n, 1], head[n, 2])
        if ti.min(va[2], vb[2]) > camera[NEAR]:
            sa, sb = to_screen(camera, va), to_screen(camera, vb)
            true_radius = radius[n] * camera[FOCAL] / sb[3]
            r = ti.min(ti.max(true_radius, 0.5), MAX_PIXEL)
            length = ti.sqrt((sa[0] - sb[0]) ** 2 + (sa[1] - sb[1]) ** 2)
            thinned = (
                true_radius * (2.0 * length + 3.14159 * true_radius) / (r * (2.0 * length + 3.14159 * r))
            )
            left = faded(fog, sb[2])
            alpha = opacity[n] * ti.min(thinned, 1.0)
            row = ti.cast(tone[n], ti.i32)
            color = ti.Vector([colors[row, c] for c in ti.static(range(3))])
            x0 = ti.max(0, ti.cast(ti.floor(ti.min(sa[0], sb[0]) - r - 0.5), ti.i32))
            x1 = ti.min(width, ti.cast(ti.max(sa[0], sb[0]) + r + 0.5, ti.i32) + 1)
            y0 = ti.max(0, ti.cast(ti.floor(ti.min(sa[1], sb[1]) - r - 0.5), ti.i32))
            y1 = ti.min(height, ti.cast(ti.max(sa[1], sb[1]) + r + 0.5, ti.i32) + 1)
            for y in range(y0, y1):
                for x in range(x0, x1):
                    t, distance = along_segment(sa, sb, x + 0.5, y + 0.5)
                    here = ti.max(r * (taper + (1.0 - taper) * t), 0.5)
                    cover = ti.min(ti.max(here + 0.5 - distance, 0.0), 1.0)
                    if joined == 1:
                        cover *= share_between(sa, sb, length, x + 0.5, y + 0.5)
                    if glow > 0.0:
                        q = distance / (here + 0.5)
                        cover = ti.max(1.0 - q * q, 0.0) ** 2
                    depth = sa[2] + (sb[2] - sa[2]) * t
                    nearest = ti.cast(
                        key[y * samples + samples // 2, x * samples + samples // 2] >> 32, ti.i32
                    )
                    if cover > 0.0 and ti.bit_cast(depth, ti.i32) <= nearest:
                        absorbed = -ti.log(1.0 - ti.min(alpha * cover, MOST_HIDDEN))
                        strength = ti.Vector([0.0, 0.0, 0.0])
                        for c in ti.static(range(3)):
                            behind = background[y, x, c]
                            strength[c] = (behind + (color[c] - behind) * left) * absorbed * scale
                        if glow > 0.0:
                            strength = color * (alpha * cover * glow * left * scale)
                            absorbed = 0.0
                        red_green = (ti.cast(strength[0], ti.i64) << 32) | ti.cast(strength[1], ti.i64)
                        blue_depth = (ti.cast(strength[2], ti.i64) << 32) | ti.cast(absorbed * scale, ti.i64)
                        ti.atomic_add(light[y, x, 0], red_green)
                        ti.atomic_add(light[y, x, 1], blue_depth)


@ti.func
def turned(q, v):
    """Vector `v` turned by the unit quaternion `q` (x, y, z, w)."""
    axis = ti.Vector([q[0], q[1], q[2]])
    twice = 2.0 * axis.cross(v)
    return v + q[3] * twice + axis.cross(twice)


@ti.kernel
def pose_shapes(
    out: f32_2d,
    position: f32_2d,
    orientation: f32_2d,
    size: f32_1d,
    vertices: f32_2d,
    motion: f32_2d,
    phase: ti.f32,
):
    """Vertices of a small shape at every point: `vertices` plus `motion` (wing beat) times a sine.

    out (n * shape vertices, 3). Each point beats at its own moment and at a slightly different rate.
    """
    count = vertices.shape[0]
    for n in range(position.shape[0]):
        q = ti.Vector([orientation[n, 0], orientation[n, 1], orientation[n, 2], orientation[n, 3]])
        mixed = (ti.cast(n, ti.u32) * ti.u32(2654435761)) >> ti.u32(8)
        own = ti.cast(mixed, ti.f32) / 16777216.0
        beat = ti.sin(phase * (0.85 + 0.3 * own) + 6.2831853 * own * 7.0)
        for k in range(count):
            local = ti.Vector([vertices[k, c] + beat * motion[k, c] for c in ti.static(range(3))])
            moved = turned(q, local * size[n])
            for c in ti.static(range(3)):
                out[n * count + k, c] = position[n, c] + moved[c]
