"""Contacts of surfaces with each other, and what they push: kernels of `self_contact.py`.

A contact is four points, their weights w (`closest.py`) and a normal n. With s = sum w_i x_i at the end of
the step it asks that s . n be at least some gap and that s slide as friction has it:

    f += (aim - s) / sum(w_i^2 / m_i),   f_n >= 0,  |f_t| <= mu f_n,   x_i += w_i / m_i df

f [kg m] is what the pair is pushed by in the step, `aim` where s is to be: as far along n as the gap, and
across as it was at the start. The contacts are gone through one after another, to and fro, so that the result
does not depend on the number of threads; each keeps momentum.
"""

from tianim.lang import f32_1d, f32_2d, f64_1d, f64_2d, i32_1d, i32_2d, ti
from tianim.systems.springs.arrays import triple
from tianim.systems.springs.closest import between, closest, meeting, reach
from tianim.systems.springs.contact import nearest_wall
from tianim.systems.springs.contact_forces import DRAWN, within_cone
from tianim.systems.springs.self_gaps import kept_apart, least_gap, wanted
from tianim.systems.springs.self_pairs import NEVER, PIECES, TURN

# Columns of a contact's numbers.
WEIGHT, NORMAL, AIM, FRICTION, FORCE, GAIN, NUMBERS = 0, 4, 7, 10, 11, 14, 15
# What would come nearer is kept this part of the thickness apart.
KEPT = 0.3


@ti.kernel
def detect(
    tasks: ti.i32, stride: ti.i32, room: ti.i32, thickness: ti.f64, start: f64_2d, end: f64_2d, pair: i32_2d,
    count: i32_1d, gap: f64_1d, flag: f32_1d, met: i32_1d,
):  # fmt: skip
    """Part of the step after which each pair comes too near, NEVER if it does not, and how many by piece."""
    count[TURN] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                hits = 0
                for k in range(piece * room, piece * room + count[piece]):
                    kind, a, b, c, d = pair[k, 0], pair[k, 1], pair[k, 2], pair[k, 3], pair[k, 4]
                    xa, xb, xc, xd = triple(start, a), triple(start, b), triple(start, c), triple(start, d)
                    pa, pb = triple(end, a) - xa, triple(end, b) - xb
                    pc, pd = triple(end, c) - xc, triple(end, d) - xd
                    far, most = gap[k], reach(kind, pa, pb, pc, pd)
                    xi = least_gap(far, thickness)
                    flag[k] = NEVER
                    if most > far - xi and far > 0.0:
                        t = meeting(kind, far, xi, most, xa, xb, xc, xd, pa, pb, pc, pd)
                        if t < 1.0:
                            flag[k] = ti.cast(ti.min(t, 0.999999), ti.f32)
                            hits += 1
                met[piece] = hits
                piece = ti.atomic_add(count[TURN], 1)


@ti.kernel
def scan(first: ti.i32, met: i32_1d, offset: i32_1d) -> ti.i32:
    """offset[p]: place of the first contact of piece p, from `first` on; how many there are then."""
    total = first
    ti.loop_config(serialize=True)
    for piece in range(PIECES):
        offset[piece] = total
        total += met[piece]
    return total


@ti.kernel
def note_contacts(
    near: ti.template(), tasks: ti.i32, stride: ti.i32, room: ti.i32, thickness: ti.f64, friction: ti.f64,
    group: i32_1d, rest: f64_2d, start: f64_2d, end: f64_2d, pair: i32_2d, count: i32_1d, gap: f64_1d,
    flag: f32_1d, offset: i32_1d, corner: i32_2d, number: f64_2d, busy: i32_1d,
):  # fmt: skip
    """Write down the contacts of the pairs that `find` (near) or `detect` has flagged."""
    count[TURN] = 0
    for block in range(tasks * stride):
        if block % stride == 0:
            piece = ti.atomic_add(count[TURN], 1)
            while piece < PIECES:
                at = offset[piece]
                for k in range(piece * room, piece * room + count[piece]):
                    if flag[k] < 1.0:
                        kind, a, b, c, d = pair[k, 0], pair[k, 1], pair[k, 2], pair[k, 3], pair[k, 4]
                        t = ti.cast(flag[k], ti.f64)
                        xa, xb, xc, xd = (
                            triple(start, a),
                            triple(start, b),
                            triple(start, c),
                            triple(start, d),
                        )
                        ya, yb = xa + t * (triple(end, a) - xa), xb + t * (triple(end, b) - xb)
                        yc, yd = xc + t * (triple(end, c) - xc), xd + t * (triple(end, d) - xd)
                        w = closest(kind, ya, yb, yc, yd)
                        n = between(w, ya, yb, yc, yd)
                        n /= ti.max(n.norm(), 1e-30)
                        s = between(w, xa, xb, xc, xd)
                        far = s.dot(n)
                        target = ti.cast(0.0, ti.f64)
                        if ti.static(near):
                            target = wanted(far, kept_apart(thickness, group, rest, kind, a, b, c, d))
                        else:
                            least = 2.0 * least_gap(gap[k], thickness)
                            target = ti.max(least, ti.min(KEPT * thickness, far))
                        aim = s + (target - far) * n
                        corner[at, 0], corner[at, 1], corner[at, 2], corner[at, 3] = a, b, c, d
                        for i in ti.static(range(4)):
                            number[at, WEIGHT + i] = w[i]
                            busy[corner[at, i]] = 1
                        for i in ti.static(range(3)):
                            number[at, NORMAL + i], number[at, AIM + i] = n[i], aim[i]
                            number[at, FORCE + i] = 0.0
                        number[at, FRICTION] = friction
                        at += 1
                piece = ti.atomic_add(count[TURN], 1)


@ti.kernel
def note_walls(
    n: ti.i32, first: ti.i32, dt: ti.f32, thickness: ti.f32, beyond: ti.f32, table: f32_2d, samples: f32_1d,
    count: ti.i32, bounds: f32_2d, friction: f32_1d, solved: f64_2d, busy: i32_1d, wall: f32_2d,
    corner: i32_2d, number: f64_2d,
) -> ti.i32:  # fmt: skip
    """Contacts with bodies of the points that touch something: they may not be pushed into them."""
    for i in range(n):
        wall[i, 3] = thickness + beyond
        if busy[i] == 1:
            hit, which = nearest_wall(table, samples, count, bounds, ti.cast(triple(solved, i), ti.f32), dt)
            for c in ti.static(range(4)):
                wall[i, c] = hit[c]
            wall[i, 4] = friction[which]
    at = first
    ti.loop_config(serialize=True)
    for i in range(n):
        if busy[i] == 1 and wall[i, 3] < thickness + beyond:
            for c in ti.static(range(4)):
                corner[at, c] = i
                number[at, WEIGHT + c] = ti.select(c == 0, 1.0, 0.0)
            for c in ti.static(range(3)):
                number[at, NORMAL + c] = wall[i, c]
                number[at, AIM + c] = solved[i, c] + (thickness - wall[i, 3]) * wall[i, c]
                number[at, FORCE + c] = 0.0
            number[at, FRICTION] = wall[i, 4]
            at += 1
    return at


@ti.kernel
def draw(
    n: ti.i32, b: ti.f64, start: i32_1d, neighbour: i32_1d, row: f32_2d, inverse_mass: f64_1d, busy: i32_1d,
    gain: f64_1d,
):  # fmt: skip
    """How much more than its own mass resists where a point is pushed, and its neighbours are not."""
    for i in range(n):
        gain[i] = 1.0
        if busy[i] == 1:
            drawn = ti.cast(0.0, ti.f64)
            for e in range(start[i], start[i + 1]):
                if busy[neighbour[e]] == 0:
                    drawn += row[e, 0] + row[e, 2] / b
            gain[i] += DRAWN * b * ti.sqrt(drawn * inverse_mass[i])


@ti.kernel
def remember(contacts: ti.i32, corner: i32_2d, head: i32_1d, after: i32_1d):
    """Chain the contacts by their first point, for `recall`."""
    for i in range(head.shape[0]):
        head[i] = -1
    ti.loop_config(serialize=True)
    for k in range(contacts):
        after[k] = head[corner[k, 0]]
        head[corner[k, 0]] = k


@ti.kernel
def recall(
    contacts: ti.i32, scale: ti.f64, corner: i32_2d, number: f64_2d, head: i32_1d, after: i32_1d,
    old_corner: i32_2d, old_force: f64_2d, gain: f64_1d,
):  # fmt: skip
    """Contacts begin with `scale` times the force of the same pair in the step before; their gains."""
    for k in range(contacts):
        f = ti.Vector([0.0, 0.0, 0.0], ti.f64)
        j = head[corner[k, 0]]
        while j >= 0:
            same = True
            for c in ti.static(range(1, 4)):
                same &= old_corner[j, c] == corner[k, c]
            if same:
                f = scale * ti.Vector([old_force[j, 0], old_force[j, 1], old_force[j, 2]])
            j = ti.select(same, -1, after[j])
        n = ti.Vector([number[k, NORMAL], number[k, NORMAL + 1], number[k, NORMAL + 2]])
        f = within_cone(f, n, number[k, FRICTION])
        mean, weights = ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
        for c in ti.static(range(4)):
            w = ti.abs(number[k, WEIGHT + c])
            mean += w * gain[corner[k, c]]
            weights += w
        number[k, GAIN] = mean / weights
        for c in ti.static(range(3)):
            number[k, FORCE + c] = f[c]


@ti.kernel
def apply(contacts: ti.i32, corner: i32_2d, number: f64_2d, inverse_mass: f64_1d, y: f64_2d):
    """Move the points by what their contacts begin with."""
    ti.loop_config(serialize=True)
    for k in range(contacts):
        for c in ti.static(range(4)):
            i = corner[k, c]
            part = number[k, GAIN] * number[k, WEIGHT + c] * inverse_mass[i]
            for d in ti.static(range(3)):
                y[i, d] = y[i, d] + part * number[k, FORCE + d]


@ti.kernel
def keep(contacts: ti.i32, corner: i32_2d, number: f64_2d, old_corner: i32_2d, old_force: f64_2d):
    """Corners and forces of the contacts, for the next step."""
    for k in range(contacts):
        for c in ti.static(range(4)):
            old_corner[k, c] = corner[k, c]
        for c in ti.static(range(3)):
            old_force[k, c] = number[k, FORCE + c]


@ti.func
def push_pair(
    inside: ti.template(), k, corner: ti.template(), number: ti.template(), inverse_mass: ti.template(),
    x: ti.template(), y: ti.template(),
):  # fmt: skip
    """Move the points of contact k as far as its force may, `inside` those of y too; by how much [m]."""
    s, give, moved = ti.Vector([0.0, 0.0, 0.0], ti.f64), ti.cast(0.0, ti.f64), ti.cast(0.0, ti.f64)
    for c in ti.static(range(4)):
        w, i = number[k, WEIGHT + c], corner[k, c]
        s += w * triple(x, i)
        give += w * w * inverse_mass[i]
    if give > 0.0:
        n = ti.Vector([number[k, NORMAL], number[k, NORMAL + 1], number[k, NORMAL + 2]])
        aim = ti.Vector([number[k, AIM], number[k, AIM + 1], number[k, AIM + 2]])
        old = ti.Vector([number[k, FORCE], number[k, FORCE + 1], number[k, FORCE + 2]])
        f = within_cone(old + (aim - s) / give, n, number[k, FRICTION])
        df = f - old
        moved = give * df.norm()
        for c in ti.static(range(3)):
            number[k, FORCE + c] = f[c]
        for c in ti.static(range(4)):
            w, i = number[k, WEIGHT + c], corner[k, c]
            for d in ti.static(range(3)):
                x[i, d] = x[i, d] + w * inverse_mass[i] * df[d]
                if ti.static(inside):
                    y[i, d] = y[i, d] + number[k, GAIN] * w * inverse_mass[i] * df[d]
    return moved


@ti.kernel
def resolve(
    inside: ti.template(), sweeps: ti.i32, contacts: ti.i32, enough: ti.f64, corner: i32_2d, number: f64_2d,
    inverse_mass: f64_1d, x: f64_2d, y: f64_2d,
):  # fmt: skip
    """Go through all contacts, to and fro, until none moves its pair by more than `enough` [m].

    `inside` the solver's iterations the forces are to stay: its inertial places y go along.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        sweep, most = 0, ti.cast(enough + 1.0, ti.f64)
        while sweep < sweeps and most > enough:
            most = 0.0
            for step in range(contacts):
                k = ti.select(sweep % 2 == 0, step, contacts - 1 - step)
                most = ti.max(most, push_pair(inside, k, corner, number, inverse_mass, x, y))
            sweep += 1


@ti.kernel
def farthest(n: ti.i32, a: f64_2d, b: f64_2d) -> ti.f64:
    """Largest distance of a point's places in a and b."""
    most = ti.cast(0.0, ti.f64)
    ti.loop_config(serialize=True)
    for i in range(n):
        ti.atomic_max(most, (triple(a, i) - triple(b, i)).norm_sqr())
    return ti.sqrt(most)


@ti.kernel
def settle_moved(
    n: ti.i32, dt: ti.f64, keep_touched: ti.i32, along: ti.i32, inverse_mass: f64_1d, start: f64_2d,
    solved: f64_2d, x: f64_2d, v: f64_2d, touched: i32_1d, busy: i32_1d,
):  # fmt: skip
    """Velocities of points that were moved; `touched` tells them, with those before where `keep_touched`.

    They go as they went in the step (`along`), or faster by what they were moved.
    """
    for i in range(n):
        moved = ti.select(along == 1, busy[i], 0)
        for c in ti.static(range(3)):
            if x[i, c] != solved[i, c]:
                moved = 1
        if keep_touched == 0 or moved == 1:
            touched[i] = moved
        if moved == 1 and inverse_mass[i] > 0.0:
            for c in ti.static(range(3)):
                d = x[i, c] - solved[i, c]
                v[i, c] = ti.select(along == 1, (x[i, c] - start[i, c]) / dt, v[i, c] + d / dt)
