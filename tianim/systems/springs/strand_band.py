"""One strand's equations: a band of 3 x 3 blocks, L D L^T of it down the strand and back, in float64.

A point couples to the second before it through bending alone, -q I, so that

    L2 = -q D''^-1,    A -= L2 D'' L1'^T,    L1 = A D'^-1,    D -= L1 A^T + L2 (-q I)
    r -= L1 r' + L2 r'',    and back up    s = D^-1 (r - A+^T s+ + q++ s++)

with ' for the point before, '' for the one before that, + and ++ for those after. What the next points need
goes on in registers; row i of `band` keeps what the way back does: the inverse of D (6, symmetric), A (9),
-q, and r (3).
"""

from tianim.lang import ti

INVERSE, BESIDE, FAR, RIGHT, WIDTH = 0, 6, 15, 16, 20


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
def eliminate(band: ti.template(), at, D, A, far, r, own, own2, last, r1, r2):
    """Go on by the point of row `at`: its D^-1, L1, r. Of those before: own, last, r1, and own2, r2."""
    A -= far * last.transpose()
    L1 = A @ own
    D -= L1 @ A.transpose() + (far * far) * own2
    r -= L1 @ r1 + far * (own2 @ r2)
    inverse = inverse_of(D)
    for c in ti.static(range(3)):
        band[at, INVERSE + c] = inverse[0, c]
        band[at, RIGHT + c] = r[c]
        for a in ti.static(range(3)):
            band[at, BESIDE + 3 * a + c] = A[a, c]
    band[at, INVERSE + 3], band[at, INVERSE + 4] = inverse[1, 1], inverse[1, 2]
    band[at, INVERSE + 5], band[at, FAR] = inverse[2, 2], far
    return inverse, L1, r


@ti.func
def substitute(band: ti.template(), at, after, after2):
    """What the point of row `at` moves. Those of the points after, in their rows: `after`, `after2`."""
    s = ti.Vector([band[at, RIGHT], band[at, RIGHT + 1], band[at, RIGHT + 2]]) - band[at + 2, FAR] * after2
    for a in ti.static(range(3)):
        for c in ti.static(range(3)):
            s[c] -= band[at + 1, BESIDE + 3 * a + c] * after[a]
    i = ti.static(INVERSE)
    inverse = ti.Matrix([
        [band[at, i], band[at, i + 1], band[at, i + 2]], [band[at, i + 1], band[at, i + 3], band[at, i + 4]],
        [band[at, i + 2], band[at, i + 4], band[at, i + 5]],
    ])  # fmt: skip
    return inverse @ s
