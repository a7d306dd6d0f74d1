"""Rotations in kernels: unit quaternions (x, y, z, w) as 4-vectors.

A quaternion turns local coordinates into world coordinates. The local axes of a thing that
has a heading are: +Z forward, +Y up, and so +X to its left (right-handed).
`tianim.math.rotations` has the same on the host.
"""

from tianim.lang import ti

# Squared length below which a direction counts as not given (f32, lengths of order one).
NO_DIRECTION = 1e-12


@ti.func
def multiply(a, b):
    """The rotation `b` first, then `a`."""
    u, v = a.xyz, b.xyz
    w = a.w * b.w - u.dot(v)
    r = a.w * v + b.w * u + u.cross(v)
    return ti.Vector([r.x, r.y, r.z, w])


@ti.func
def conjugate(q):
    """The opposite rotation."""
    return ti.Vector([-q.x, -q.y, -q.z, q.w])


@ti.func
def rotate(q, v):
    """The vector `v`, local, in world axes."""
    u = q.xyz
    t = 2.0 * u.cross(v)
    return v + q.w * t + u.cross(t)


@ti.func
def rotate_back(q, v):
    """The vector `v`, world, in local axes."""
    u = -q.xyz
    t = 2.0 * u.cross(v)
    return v + q.w * t + u.cross(t)


@ti.func
def from_axis_angle(axis, angle):
    """The turn by `angle` [rad] about the unit vector `axis`."""
    s = ti.sin(0.5 * angle)
    return ti.Vector([axis.x * s, axis.y * s, axis.z * s, ti.cos(0.5 * angle)])


@ti.func
def any_perpendicular(v):
    """A unit vector at right angles to the unit vector `v`."""
    other = ti.Vector([1.0, 0.0, 0.0])
    if ti.abs(v.x) > 0.7:
        other = ti.Vector([0.0, 1.0, 0.0])
    return v.cross(other).normalized()


@ti.func
def look_rotation(forward, up):
    """Local +Z onto `forward`, local +Y as near to `up` as that allows.

    Neither needs unit length. `up` along `forward` gives some roll; `forward` zero gives +Z.
    """
    z = ti.Vector([0.0, 0.0, 1.0])
    if forward.norm_sqr() > NO_DIRECTION:
        z = forward.normalized()
    x = any_perpendicular(z)
    across = up.cross(z)
    if across.norm_sqr() > NO_DIRECTION * up.norm_sqr():
        x = across.normalized()
    return from_axes(x, z.cross(x), z)


@ti.func
def from_axes(x, y, z):
    """The rotation whose local axes lie along the orthonormal, right-handed `x`, `y`, `z`."""
    # Shepperd's method: divide by the largest of the four components.
    trace = x.x + y.y + z.z
    q = ti.Vector([0.0, 0.0, 0.0, 1.0])
    if trace >= x.x and trace >= y.y and trace >= z.z:
        q = ti.Vector([y.z - z.y, z.x - x.z, x.y - y.x, 1.0 + trace])
    elif x.x >= y.y and x.x >= z.z:
        q = ti.Vector([1.0 + x.x - y.y - z.z, x.y + y.x, z.x + x.z, y.z - z.y])
    elif y.y >= z.z:
        q = ti.Vector([x.y + y.x, 1.0 - x.x + y.y - z.z, y.z + z.y, z.x - x.z])
    else:
        q = ti.Vector([z.x + x.z, y.z + z.y, 1.0 - x.x - y.y + z.z, x.y - y.x])
    return q.normalized()


@ti.func
def slerp(a, b, t):
    """From `a` (t = 0) to `b` (t = 1) by the shorter way at constant angular speed."""
    cosine = a.dot(b)
    end = b
    if cosine < 0.0:
        end, cosine = -b, -cosine
    left, right = 1.0 - t, t
    # Close together the sine vanishes and the straight line is exact to rounding.
    if cosine < 0.9995:
        angle = ti.acos(cosine)
        left = ti.sin((1.0 - t) * angle) / ti.sin(angle)
        right = ti.sin(t * angle) / ti.sin(angle)
    return (left * a + right * end).normalized()
