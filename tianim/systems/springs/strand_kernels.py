"""Contacts of strands with each other, and what they push: kernels of `strand_contact.py`.

A contact is two segments, the weights w of their four points (`closest.py`) and a normal n. With
s = sum w_i x_i, the way from one to the other, at the end of the step:

    f += (aim - s) / sum(w_i^2 / m_i),   f_n >= 0,  |f_t| <= mu f_n,   x_i += w_i / m_i df

f [kg m] is what the two are pushed by in the step, `aim` where s is to be: as far along n as they are to be
apart, and across as at the start. What touches a body too has a contact of one point with it, in the same
list. So that this does not stretch the strands, their segments pull too, as their springs do in a step b:

    f += (l' - l - f / (k b^2)) / (1 / m_a + 1 / m_b + 1 / (k b^2))

l' being their length after the solver's step. All are gone through one after another, to and fro, so that
nothing depends on the number of threads; each keeps momentum.
"""

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.closest import EDGE_EDGE, between, edge_edge, meeting, reach
from tianim.systems.springs.contact import nearest_wall
from tianim.systems.springs.self_gaps import MARGIN, NEAR, least_gap, wanted
from tianim.systems.springs.self_kernels import AIM, FORCE, FRICTION, NORMAL, WEIGHT, push_pair
from tianim.systems.springs.self_pairs import NEVER
from tianim.systems.springs.strand_pairs import PIECES, TURN

# What would come nearer than it may is kept this part of the thickness apart.
KEPT = 0.9


@ti.kernel
def flag_near(
    room: ti.i32, thickness: ti.f64, start: f64_2d, end: f64_2d, pair: i32_2d, gap: f64_1d, count: i32_1d,
    flag: f32_1d,
):  # fmt: skip
    """Part of the step after which pairs touch: 0 for what is near and would come too near, or NEVER."""
    for k in range(PIECES * room):
        flag[k] = NEVER
        if k % room < count[k // room] and gap[k] > 0.0:
            a, b, far = pair[k, 0], pair[k, 1], gap[k]
            xa, xb, xc, xd = triple(start, a), triple(start, a + 1), triple(start, b), triple(start, b + 1)
            ya, yb, yc, yd = triple(end, a), triple(end, a + 1), triple(end, b), triple(end, b + 1)
            if far < NEAR * thickness:
                w = edge_edge(xa, xb, xc, xd)
                then = between(w, ya, yb, yc, yd).dot(between(w, xa, xb, xc, xd) / far)
                if then < wanted(far, thickness) + MARGIN * thickness:
                    flag[k] = 0.0
            else:
                pa, pb, pc, pd = ya - xa, yb - xb, yc - xc, yd - xd
                most = reach(EDGE_EDGE, pa, pb, pc, pd)
                if most > far - thickness:
                    t = meeting(EDGE_EDGE, far, thickness, most, xa, xb, xc, xd, pa, pb, pc, pd)
                    flag[k] = ti.select(t < 1.0, ti.cast(ti.min(t, 0.999999), ti.f32), NEVER)


@ti.kernel
def flag_meeting(
    tasks: ti.i32, stride: ti.i32, room: ti.i32, thickness: ti.f64, start: f64_2d, end: f64_2d, pair: i32_2d,
    gap: f64_1d, count: i32_1d, flag: f32_1d,
) -> ti.i32:  # fmt: skip
    """Part of the step after which each pair comes too near, NEVER if it does not; how many do."""
    count[TURN] = 0
    met = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                hits = 0
                for k in range(piece * room, piece * room + count[piece]):
                    a, b, far = pair[k, 0], pair[k, 1], gap[k]
                    xa, xb, xc, xd = (
                        triple(start, a),
                        triple(start, a + 1),
                        triple(start, b),
                        triple(start, b + 1),
                    )
                    pa, pb = triple(end, a) - xa, triple(end, a + 1) - xb
                    pc, pd = triple(end, b) - xc, triple(end, b + 1) - xd
                    most, xi = reach(EDGE_EDGE, pa, pb, pc, pd), least_gap(far, thickness)
                    flag[k] = NEVER
                    if most > far - xi and far > 0.0:
                        t = meeting(EDGE_EDGE, far, xi, most, xa, xb, xc, xd, pa, pb, pc, pd)
                        if t < 1.0:
                            flag[k] = ti.cast(ti.min(t, 0.999999), ti.f32)
                            hits += 1
                met += hits
                piece = ti.atomic_add(count[TURN], 1)
    return met


@ti.kernel
def note_contacts(
    near: ti.template(), contacts: ti.i32, most: ti.i32, room: ti.i32, thickness: ti.f64, friction: ti.f64,
    start: f64_2d, end: f64_2d, pair: i32_2d, gap: f64_1d, count: i32_1d, flag: f32_1d, corner: i32_2d,
    number: f64_2d, busy: i32_1d,
) -> ti.i32:  # fmt: skip
    """Write down the contacts of what is flagged, where there is room for them; how many there are then."""
    at = contacts
    ti.loop_config(serialize=True)
    for piece in range(PIECES):
        for k in range(piece * room, piece * room + count[piece]):
            if flag[k] < 1.0:
                if at < most:
                    t = ti.cast(flag[k], ti.f64)
                    a, b = pair[k, 0], pair[k, 1]
                    xa, xb, xc, xd = (
                        triple(start, a),
                        triple(start, a + 1),
                        triple(start, b),
                        triple(start, b + 1),
                    )
                    ya, yb = xa + t * (triple(end, a) - xa), xb + t * (triple(end, a + 1) - xb)
                    yc, yd = xc + t * (triple(end, b) - xc), xd + t * (triple(end, b + 1) - xd)
                    w = edge_edge(ya, yb, yc, yd)
                    n = between(w, ya, yb, yc, yd)
                    n /= ti.max(n.norm(), 1e-30)
                    s = between(w, xa, xb, xc, xd)
                    far = s.dot(n)
                    target = wanted(far, thickness)
                    if ti.static(not near):
                        target = ti.max(2.0 * least_gap(gap[k], thickness), ti.min(KEPT * thickness, far))
                    aim = s + (target - far) * n
                    corner[at, 0], corner[at, 1], corner[at, 2], corner[at, 3] = a, a + 1, b, b + 1
                    for i in ti.static(range(4)):
                        number[at, WEIGHT + i] = w[i]
                        busy[corner[at, i]] = 1
                    for i in ti.static(range(3)):
                        number[at, NORMAL + i], number[at, AIM + i] = n[i], aim[i]
                        number[at, FORCE + i] = 0.0
                    number[at, FRICTION] = friction
                at += 1
    return at


@ti.kernel
def note_walls(
    n: ti.i32, contacts: ti.i32, dt: ti.f32, thickness: ti.f32, beyond: ti.f32, table: f32_2d,
    samples: f32_1d, count: ti.i32, bounds: f32_2d, friction: f32_1d, solved: f64_2d, busy: i32_1d,
    corner: i32_2d, number: f64_2d,
) -> ti.i32:  # fmt: skip
    """Contacts with bodies of the points that touch something: they may not be pushed into them."""
    at = contacts
    ti.loop_config(serialize=True)
    for i in range(n):
        if busy[i] == 1:
            busy[i] = 2  # once a step
            hit, which = nearest_wall(
                table, samples, count, bounds, ti.cast(triple(solved, i), ti.f32), dt
            )  # fmt: skip
            if hit.w < thickness + beyond:
                for c in ti.static(range(4)):
                    corner[at, c] = i
                    number[at, WEIGHT + c] = ti.select(c == 0, 1.0, 0.0)
                for c in ti.static(range(3)):
                    number[at, NORMAL + c] = hit[c]
                    number[at, AIM + c] = solved[i, c] + (thickness - hit.w) * hit[c]
                    number[at, FORCE + c] = 0.0
                number[at, FRICTION] = friction[which]
                at += 1
    return at


@ti.kernel
def note_taut(
    strands: ti.i32, first: i32_1d, busy: i32_1d, solved: f64_2d, taut: i32_1d, pull: f64_2d
) -> ti.i32:
    """All segments of the strands that touch something, by their second points; how many."""
    at = 0
    ti.loop_config(serialize=True)
    for strand in range(strands):
        touches = 0
        for i in range(first[strand], first[strand + 1]):
            touches += busy[i]
        if touches > 0:
            for i in range(first[strand] + 1, first[strand + 1]):
                taut[at], pull[at, 0] = i, 0.0
                pull[at, 1] = (triple(solved, i) - triple(solved, i - 1)).norm()
                at += 1
    return at


@ti.func
def keep_length(k, b, taut: ti.template(), pull: ti.template(), back: ti.template(), row: ti.template(),
    inverse_mass: ti.template(), x: ti.template(),
):  # fmt: skip
    """Move the ends of a segment together or apart, as far as its spring has it; by how much [m]."""
    i, moved = taut[k], ti.cast(0.0, ti.f64)
    wa, wb = inverse_mass[i - 1], inverse_mass[i]
    if wa + wb > 0.0:
        d = triple(x, i) - triple(x, i - 1)
        length = ti.max(d.norm(), 1e-20)
        give = 1.0 / ti.max(row[back[i], 0] * b * b, 1e-20)
        df = (pull[k, 1] - length - give * pull[k, 0]) / (wa + wb + give)
        pull[k, 0] = pull[k, 0] + df
        for c in ti.static(range(3)):
            x[i - 1, c] = x[i - 1, c] - wa * df * d[c] / length
            x[i, c] = x[i, c] + wb * df * d[c] / length
        moved = ti.abs((wa + wb) * df)
    return moved


@ti.kernel
def resolve(
    sweeps: ti.i32, contacts: ti.i32, segments: ti.i32, b: ti.f64, enough: ti.f64, corner: i32_2d,
    number: f64_2d, taut: i32_1d, pull: f64_2d, back: i32_1d, row: f32_2d, inverse_mass: f64_1d, x: f64_2d,
):  # fmt: skip
    """Go through all segments and contacts, to and fro, until none moves by more than `enough` [m]."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        sweep, most = 0, ti.cast(enough + 1.0, ti.f64)
        while sweep < sweeps and most > enough:
            most = 0.0
            for step in range(segments):
                k = ti.select(sweep % 2 == 0, step, segments - 1 - step)
                most = ti.max(most, keep_length(k, b, taut, pull, back, row, inverse_mass, x))
            for step in range(contacts):
                k = ti.select(sweep % 2 == 0, step, contacts - 1 - step)
                most = ti.max(most, push_pair(False, k, corner, number, inverse_mass, x, x))
            sweep += 1


@ti.kernel
def settle_moved(
    n: ti.i32, dt: ti.f64, inverse_mass: f64_1d, start: f64_2d, solved: f64_2d, x: f64_2d, v: f64_2d
):
    """Points that were moved go as they went in the step."""
    for i in range(n):
        moved = 0
        for c in ti.static(range(3)):
            if x[i, c] != solved[i, c]:
                moved = 1
        if moved == 1 and inverse_mass[i] > 0.0:
            for c in ti.static(range(3)):
                v[i, c] = (x[i, c] - start[i, c]) / dt
