"""How near two parts of a mesh are, now and on their way through a step: point and triangle, edge and edge.

Both kinds are four points and four weights that sum to zero: s = sum_i w_i x_i is the vector between the
closest places, with w = (1, -a, -b, -c) for a point and a triangle and (1 - s, s, t - 1, -t) for two edges
(Ericson, Real-Time Collision Detection, 2005, 5.1).

The swept test is additive continuous detection (Li et al. 2021, doi:10.1145/3450626.3459767): points that
move by p_i, less their common motion, close in by no more than l = max |p| of one side + max |p| of the
other, so that the part

    t += 0.9 (d - xi) / l

of the step can be gone without coming nearer than xi, and so on until the step is over or d is xi. It
uses distances alone, so that flat, parallel and still pairs, on which the roots of the cubic of coplanarity
(Provot 1997) are lost or many, need no care, and an error of rounding makes it stop early, never late.
"""

from tianim.lang import ti

POINT_TRIANGLE, EDGE_EDGE = 0, 1
# Part of the way that is gone at a time; where a pair counts as met, as a part of xi; at most so many times.
ADVANCE, MET, MOST_ADVANCES = 0.9, 0.1, 100
# Squared sines below this are of parallel edges, or of triangles without area.
FLAT = 1e-12


@ti.func
def clamped(x):
    """X within 0 to 1."""
    return ti.min(ti.max(x, 0.0), 1.0)


@ti.func
def along(p, a, b):
    """Part of the way from a to b that is nearest to p."""
    ab = b - a
    return clamped((p - a).dot(ab) / ti.max(ab.norm_sqr(), 1e-37))


@ti.func
def point_triangle(p, a, b, c):
    """Weights of a point and the nearest place of a triangle."""
    ab, ac, ap = b - a, c - a, p - a
    uu, uv, vv, pu, pv = ab.norm_sqr(), ab.dot(ac), ac.norm_sqr(), ap.dot(ab), ap.dot(ac)
    det = uu * vv - uv * uv
    inverse = 1.0 / ti.max(det, 1e-37)
    wb, wc = (vv * pu - uv * pv) * inverse, (uu * pv - uv * pu) * inverse
    w = ti.Vector([1.0, wb + wc - 1.0, -wb, -wc], ti.f64)
    if det <= FLAT * uu * vv or wb < 0.0 or wc < 0.0 or wb + wc > 1.0:
        t, u, v = along(p, a, b), along(p, b, c), along(p, c, a)
        dt = (p - a - t * (b - a)).norm_sqr()
        du = (p - b - u * (c - b)).norm_sqr()
        dv = (p - c - v * (a - c)).norm_sqr()
        w = ti.Vector([1.0, t - 1.0, -t, 0.0], ti.f64)
        if du < dt and du <= dv:
            w = ti.Vector([1.0, 0.0, u - 1.0, -u], ti.f64)
        elif dv < dt:
            w = ti.Vector([1.0, -v, 0.0, v - 1.0], ti.f64)
    return w


@ti.func
def edge_edge(a, b, c, d):
    """Weights of the nearest places of the edges a b and c d."""
    u, v, r = b - a, d - c, a - c
    uu, vv, uv, ur, vr = u.norm_sqr(), v.norm_sqr(), u.dot(v), u.dot(r), v.dot(r)
    det = uu * vv - uv * uv
    s = ti.cast(0.0, ti.f64)
    if det > FLAT * uu * vv:
        s = clamped((uv * vr - ur * vv) / det)
    t = (uv * s + vr) / ti.max(vv, 1e-37)
    if t < 0.0 or t > 1.0:
        t = clamped(t)
        s = clamped((t * uv - ur) / ti.max(uu, 1e-37))
    return ti.Vector([1.0 - s, s, t - 1.0, -t], ti.f64)


@ti.func
def closest(kind, a, b, c, d):
    """Weights of either kind."""
    w = ti.Vector([0.0, 0.0, 0.0, 0.0], ti.f64)
    if kind == POINT_TRIANGLE:  # noqa: SIM108  (a ternary would evaluate both)
        w = point_triangle(a, b, c, d)
    else:
        w = edge_edge(a, b, c, d)
    return w


@ti.func
def between(w, a, b, c, d):
    """The vector between the closest places."""
    return w[0] * a + w[1] * b + w[2] * c + w[3] * d


@ti.func
def reach(kind, pa, pb, pc, pd):
    """By how much a pair whose points move by p can come nearer, at most."""
    mean = 0.25 * (pa + pb + pc + pd)
    a, b = (pa - mean).norm_sqr(), (pb - mean).norm_sqr()
    c, d = (pc - mean).norm_sqr(), (pd - mean).norm_sqr()
    edges = ti.sqrt(ti.max(a, b)) + ti.sqrt(ti.max(c, d))
    return ti.select(kind == POINT_TRIANGLE, ti.sqrt(a) + ti.sqrt(ti.max(b, c, d)), edges)


@ti.func
def meeting(kind, gap, xi, most, a, b, c, d, pa, pb, pc, pd):
    """Part of the step after which a pair is as near as xi, 2 if it never is.

    `gap` is its distance at the start, `most` its `reach`.
    """
    t, found, times = ti.cast(0.0, ti.f64), ti.cast(2.0, ti.f64), 0
    met = MET * ti.min(gap - xi, xi)
    left = gap - xi
    while times < MOST_ADVANCES and t < 1.0 and found > 1.0:
        if times > 0 and left < met:
            found = t
        else:
            t += ADVANCE * left / most
            if t < 1.0:
                xa, xb, xc, xd = a + t * pa, b + t * pb, c + t * pc, d + t * pd
                left = between(closest(kind, xa, xb, xc, xd), xa, xb, xc, xd).norm() - xi
            times += 1
    if t < 1.0:
        found = t
    return found
