"""Walls in kernels: rows of the wall table, and the share of a particle's surroundings that is solid.

A wall's row is its body's row (see `spatial.bodies`) and three columns more. Lengths are divided by the
distance up to which walls are felt (`wall_tables.reach`), called `support` here.

Half spaces and containers may reach through each other (the corner of a tank made of planes): they leave
free what each of them leaves free, 1 - prod (1 - lambda_b). Solids do not overlap, and are added.
"""

from tianim.lang import ti
from tianim.math.quaternion import rotate, rotate_back
from tianim.spatial.bodies import (
    KIND,
    PLANE,
    POSITION,
    ROTATION,
    ROUNDING,
    SHAPE,
    SIGN,
    WIDTH,
    signed_distance,
)
from tianim.spatial.sections import in_plane
from tianim.systems.fluid.wall_tables import (
    BALL,
    BALL_SLOPE,
    CORNER,
    CORNER_SLOPE,
    ROD,
    curved,
    look_up,
    slab,
)

# Columns after those of the body.
FORM = WIDTH
COULOMB = WIDTH + 1  # friction force over normal force
FLAT = WIDTH + 2  # 1 in two dimensions: no gradient along z
WALL_WIDTH = WIDTH + 3

# Forms: by the distance alone (plane, mesh), and those that have shares of their own.
BY_DISTANCE, BOX, CAPSULE, CYLINDER = 0, 1, 2, 3


@ti.func
def _box_share(shares: ti.template(), p, half):
    """Slope (x, y, z) and share of a solid box at local `p`, in supports: slabs, less their corners."""
    x = slab(shares, p.x, half.x)
    y = slab(shares, p.y, half.y)
    z = slab(shares, p.z, half.z)
    return ti.Vector([
        x[1] * (y[0] * z[0] - y[2] * z[2]) - x[3] * (y[2] * z[0] + z[2] * y[0]),
        y[1] * (x[0] * z[0] - x[2] * z[2]) - y[3] * (x[2] * z[0] + z[2] * x[0]),
        z[1] * (x[0] * y[0] - x[2] * y[2]) - z[3] * (x[2] * y[0] + y[2] * x[0]),
        x[0] * y[0] * z[0] - x[2] * y[2] * z[0] - x[2] * z[2] * y[0] - y[2] * z[2] * x[0],
    ])  # fmt: skip


@ti.func
def _capsule_share(shares: ti.template(), p, half, radius):
    """Slope and share of a solid capsule, or with `half` 0 a sphere: a rod, and a ball from its ends on."""
    along = ti.max(ti.min(p.y, half), -half)
    arm = ti.Vector([p.x, p.y - along, p.z])
    r = arm.norm()
    s = r - radius
    ball = curved(shares, BALL, s, 1.0 / radius)
    beyond, change, rod = 1.0, 0.0, ball
    if half > 0.0:
        past = ti.abs(p.y) - half
        beyond = ti.max(ti.min(0.5 + 0.5 * past, 1.0), 0.0)
        if ti.abs(past) < 1.0:
            change = ti.select(p.y < 0.0, -0.5, 0.5)
        rod = curved(shares, ROD, s, 1.0 / radius)
    both = beyond * ball + (1.0 - beyond) * rod
    g = both[1] * arm / ti.max(r, 1e-6)
    return ti.Vector([g.x, g.y + change * (ball[0] - rod[0]), g.z, both[0]])


@ti.func
def _cylinder_share(shares: ti.template(), p, half):
    """Slope and share of a solid cylinder along y: a rod cut to a slab. `half`: radius, half length."""
    r = ti.Vector([p.x, 0.0, p.z]).norm()
    s = r - half.x
    rod = curved(shares, ROD, s, 1.0 / half.x)
    rim, rim_slope = look_up(shares, CORNER, s), look_up(shares, CORNER_SLOPE, s)
    y = slab(shares, p.y, half.y)
    across = (rod[1] * y[0] + rim_slope * y[2]) / ti.max(r, 1e-6)
    return ti.Vector([
        across * p.x, rod[0] * y[1] + rim * y[3], across * p.z, rod[0] * y[0] + rim * y[2],
    ])  # fmt: skip


@ti.func
def body_share(table: ti.template(), shares: ti.template(), support, b, x, hit):
    """Gradient [1/m] and share of wall `b` at `x`, which sees it at `hit`, nearer than `support` [m]."""
    rotation = ti.Vector(
        [table[b, ROTATION], table[b, ROTATION + 1], table[b, ROTATION + 2], table[b, ROTATION + 3]]
    )
    origin = ti.Vector([table[b, POSITION], table[b, POSITION + 1], table[b, POSITION + 2]])
    p = rotate_back(rotation, x - origin) / support
    half = ti.Vector([table[b, SHAPE], table[b, SHAPE + 1], table[b, SHAPE + 2]]) / support
    form = ti.cast(table[b, FORM], ti.i32)
    solid = ti.Vector([0.0, 0.0, 0.0, 0.0])
    if form == BOX:
        solid = _box_share(shares, p, half)
    elif form == CAPSULE:
        solid = _capsule_share(shares, p, half.y, table[b, ROUNDING] / support)
    elif form == CYLINDER:
        solid = _cylinder_share(shares, p, half)
    g, share = table[b, SIGN] * rotate(rotation, solid.xyz), solid.w
    if table[b, SIGN] < 0.0:
        share = 1.0 - share
    if form == BY_DISTANCE:
        g = look_up(shares, BALL_SLOPE, hit.w / support) * hit.xyz
        share = look_up(shares, BALL, hit.w / support)
    if table[b, FLAT] > 0.0:
        g.z = 0.0
    return ti.Vector([g.x / support, g.y / support, g.z / support, share])


@ti.func
def flat(table: ti.template(), b, hit):
    """The `hit` of wall `b`, in two dimensions along the plane."""
    if table[b, FLAT] > 0.0:
        hit = in_plane(hit)
    return hit


@ti.func
def is_open_ended(table: ti.template(), b):
    """Whether wall `b` is a half space or a container."""
    return table[b, SIGN] < 0.0 or table[b, KIND] == PLANE


@ti.func
def wall_terms(table: ti.template(), samples: ti.template(), shares: ti.template(), support, count, x):
    """Gradient (x, y, z) [1/m] and share lambda of all `count` walls at `x`: for inner iterations.

    Farther than `support` [m] from every wall both are 0: skip the call where that is known.
    """
    g, added = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0, 0.0])
    free = 1.0
    for b in range(count):
        hit = flat(table, b, signed_distance(table, samples, b, x))
        if hit.w < support:
            own = body_share(table, shares, support, b, x, hit)
            if is_open_ended(table, b):
                g = g * (1.0 - own.w) + own.xyz * free
                free *= 1.0 - own.w
            else:
                added += own
    total = ti.min(1.0 - free + added.w, 1.0)
    return ti.Vector([g.x + added.x, g.y + added.y, g.z + added.z, total])
