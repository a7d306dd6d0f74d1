"""One strand's equations: a band of 3 x 3 blocks, L D L^T of it down the strand and back, in float64.

Row i of `band` is a point of the strand: the inverse of D (6, symmetric), L of the point before (9), of the
one before that (9). A point couples to the second before it through bending alone, -q I, so that

    L2 = -q D''^-1,    A -= L2 D'' L1'^T,    L1 = A D'^-1,    D -= L1 A^T + L2 (-q I)

with ' for the point before and '' for the one before that. Some 600 operations a point and iteration, one
after another; the band of a strand stays in the nearest cache.
"""

from tianim.lang import ti

INVERSE, ONE, TWO, WIDTH = 0, 6, 15, 24


@ti.func
def inverse_of(m):
    """Of a symmetric 3 x 3 matrix."""
    a = m[1, 1] * m[2, 2] - m[1, 2] * m[1, 2]
    b = m[0, 2] * m[1, 2] - m[0, 1] * m[2, 2]
    c = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    d = m[0, 0] * m[2, 2] - m[0, 2] * m[0, 2]
    e = m[0, 1] * m[0, 2] - m[0, 0] * m[1, 2]
    f = m[0, 0] * m[1, 1] - m[0, 1] * m[0, 1]
    s = 1.0 / (m[0, 0] * a + m[0, 1] * b + m[0, 2] * c)
    return ti.Matrix([[a * s, b * s, c * s], [b * s, d * s, e * s], [c * s, e * s, f * s]])


@ti.func
def zero():
    """No block."""
    return ti.Matrix([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]], ti.f64)


@ti.func
def stored(band: ti.template(), p):
    """The inverse of D of row p."""
    return ti.Matrix([
        [band[p, 0], band[p, 1], band[p, 2]], [band[p, 1], band[p, 3], band[p, 4]],
        [band[p, 2], band[p, 4], band[p, 5]],
    ])  # fmt: skip


@ti.func
def eliminate(band: ti.template(), z: ti.template(), at, first, D, A, far, r, last):
    """Go on by the point of row `at`; its L of the point before, which is `last` of the next point."""
    L1, L2 = zero(), zero()
    if far != 0.0:
        p = at - 2
        L2 = far * stored(band, p)
        A -= far * last.transpose()
        D -= far * L2
        r -= L2 @ ti.Vector([z[p, 0], z[p, 1], z[p, 2]])
    if not first:
        p = at - 1
        L1 = A @ stored(band, p)
        D -= L1 @ A.transpose()
        r -= L1 @ ti.Vector([z[p, 0], z[p, 1], z[p, 2]])
    own = inverse_of(D)
    band[at, 0], band[at, 1], band[at, 2] = own[0, 0], own[0, 1], own[0, 2]
    band[at, 3], band[at, 4], band[at, 5] = own[1, 1], own[1, 2], own[2, 2]
    for a in ti.static(range(3)):
        for c in ti.static(range(3)):
            band[at, ONE + 3 * a + c] = L1[a, c]
            band[at, TWO + 3 * a + c] = L2[a, c]
        z[at, a] = r[a]
    return L1


@ti.func
def substitute(band: ti.template(), z: ti.template(), begin, total):
    """Back up the strand: z becomes what its points move."""
    for back in range(total):
        i = begin + total - 1 - back
        s = stored(band, i) @ ti.Vector([z[i, 0], z[i, 1], z[i, 2]])
        for ahead in ti.static(range(1, 3)):
            if back >= ahead:
                j = i + ahead
                column = ti.static(ONE if ahead == 1 else TWO)
                for a in ti.static(range(3)):
                    for c in ti.static(range(3)):
                        s[c] -= band[j, column + 3 * a + c] * z[j, a]
        for c in ti.static(range(3)):
            z[i, c] = s[c]
