"""How far an iteration of the projective solver goes: to the least energy along its way and the one before.

    x += d,    d = a z + c p,    z = A^-1 r,   p = d of the iteration before

    | zHz  zHp | | a |   | z.r |
    | zHp  pHp | | c | = | p.r |

H is the Hessian of the energy where x is, without what is negative of it: springs that are pressed count as
slack across. H p goes on as d does, as if x were where it was (locally optimal conjugate gradients, Knyazev
2001, doi:10.1137/S1064827500366124).

A alone, which bounds H from above, goes too short a way where springs turn. Of the energy that was too much
in a step of a sheet that is wrung, five iterations of it left 0.14, and leave 0.08 so; twenty left 0.08, and
leave 0.008.

The first iteration of a step goes z, which gives what is free the motion of its centre exactly; no later one
changes that. Where forces of contact change between the iterations the last goes z too: what is farther would
be energy that nothing takes back (a cloth on the rim of a table gains 0.005 J a step at most, for 0.025).
Sums are kept by piece and added in their order, whoever does the pieces.
"""

from tianim.lang import ti
from tianim.spatial.crew import pieces

ZZ, ZP, PP, ZR, PR, SUMS = 0, 1, 2, 3, 4, 5
# Ways that are nearly the same, whose matrix's determinant is less than this part of its diagonal's, are one.
ALIKE = 1e-5


@ti.func
def curved(
    damped: ti.template(), b, start: ti.template(), neighbour: ti.template(), row: ti.template(),
    inverse_mass: ti.template(), base: ti.template(), x: ti.template(), place: ti.template(),
    z: ti.template(), i,
):  # fmt: skip
    """Row i of H z [N]."""
    f = ti.Vector([0.0, 0.0, 0.0])
    if inverse_mass[i] > 0.0:
        own = place[i]
        zi = ti.Vector([z[own, 0], z[own, 1], z[own, 2]])
        f = ti.cast(1.0 / (inverse_mass[i] * b * b), ti.f32) * zi
        for e in range(start[i], start[i + 1]):
            j = neighbour[e]
            at = place[j]
            dz = zi - ti.Vector([z[at, 0], z[at, 1], z[at, 2]])
            dx = ti.cast(x[j, 0] - x[i, 0], ti.f32)
            dy = ti.cast(x[j, 1] - x[i, 1], ti.f32)
            dw = ti.cast(x[j, 2] - x[i, 2], ti.f32)
            inverse = 1.0 / ti.sqrt(ti.max(dx * dx + dy * dy + dw * dw, 1e-30))
            n = inverse * ti.Vector([dx, dy, dw])
            across = row[e, 0] * ti.max(1.0 - row[e, 1] * inverse, 0.0)
            f += (across + row[e, 3]) * dz + ((row[e, 0] - across) * n.dot(dz)) * n
            if ti.static(damped):
                bx = ti.cast(base[j, 0] - base[i, 0], ti.f32)
                by = ti.cast(base[j, 1] - base[i, 1], ti.f32)
                bz = ti.cast(base[j, 2] - base[i, 2], ti.f32)
                n = ti.Vector([bx, by, bz])
                s = row[e, 2] / (ti.cast(b, ti.f32) * ti.max(n.norm_sqr(), 1e-30))
                f += (s * n.dot(dz)) * n
    return f


@ti.func
def lengths(n, sums: ti.template()):
    """The lengths a and c."""
    total = ti.Vector([0.0, 0.0, 0.0, 0.0, 0.0], ti.f64)
    for piece in range(pieces(n)):
        for s in ti.static(range(SUMS)):
            total[s] += sums[s, piece]
    a, c = ti.cast(1.0, ti.f64), ti.cast(0.0, ti.f64)
    zz, zp, pp, zr, pr = total[ZZ], total[ZP], total[PP], total[ZR], total[PR]
    if zz > 0.0 and zr > 0.0:
        a = zr / zz
        det = zz * pp - zp * zp
        if det > ALIKE * zz * pp:
            a, c = (pp * zr - zp * pr) / det, (zz * pr - zp * zr) / det
    return a, c
