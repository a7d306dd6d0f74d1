"""The passes of a pressure solve, on one particle each, and the kernels that run them (see pressure.py)."""

from tianim.lang import f32_1d, f32_2d, i32_1d, i32_2d, ti
from tianim.spatial.crew import first_of, last_of, meet, pieces, take

MOTION, DRIFT = 0, 1
PREPARE, ACCELERATE, RELAX, FINISH = 0, 1, 2, 3
# A gap in the fluid of less than so much of its density is not let shut at once, but with this time [s].
# Shut within a step it would set the particles about it going, and these make the next gaps.
GAP = 0.05
CLOSING = 0.3
# Particles out of order may have a larger eigenvalue than the lattice: where the error grows by so much over
# the least so far, the relaxation is made smaller.
GROWTH = 2.0
SLOWER = 0.7
ENDLESS = 1e30


@ti.func
def prepare(
    stage: ti.template(),
    i,
    dt,
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    wall: ti.template(),
    flux: ti.template(),
    total: ti.template(),
    v: ti.template(),
    density: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    lone,
):
    """Source, diagonal and total gradient of particle i; gives max(b, 0)."""
    a, b, c = v[0, i], v[1, i], v[2, i]
    rate, square = 0.0, 0.0
    s = ti.Vector([0.0, 0.0, 0.0])
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        x, y, z = gradient[0, k], gradient[1, k], gradient[2, k]
        rate += x * (a - v[0, j]) + y * (b - v[1, j]) + z * (c - v[2, j])
        square += (x * x + y * y + z * z) * inverse_rho[phase[0, j]]
        s[0] += x
        s[1] += y
        s[2] += z
    g = ti.Vector([wall[0, i], wall[1, i], wall[2, i]])
    rate += g[0] * a + g[1] * b + g[2] * c - flux[i]
    s += g
    total[0, i], total[1, i], total[2, i] = s[0], s[1], s[2]
    diagonal[i] = square + inverse_rho[phase[0, i]] * s.norm_sqr()
    if ti.static(stage == MOTION):
        gap = ti.max(1.0 - density[i], 0.0)
        source[i] = rate / dt - ti.max(gap - GAP, 0.0) / (dt * dt) - gap / (dt * CLOSING)
    else:
        source[i] = rate / dt + (density[i] - 1.0) / (dt * dt)
    return ti.select(diagonal[i] > lone, ti.max(source[i], 0.0), 0.0)


@ti.func
def accelerate(
    last_one: ti.template(),
    i,
    row: ti.template(),
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    back: ti.template(),
    total: ti.template(),
    warm: ti.template(),
    last: ti.template(),
    push: ti.template(),
):
    """Acceleration of particle i by the pressures of now; by those of `last`, where it is the `last_one`."""
    p = warm[row, i]
    if ti.static(last_one):
        p = last[i]
    x, y, z = p * total[0, i], p * total[1, i], p * total[2, i]
    for k in range(begin[i], end[i]):
        q = last[neighbour[k]] if ti.static(last_one) else warm[row, neighbour[k]]
        x += q * back[0, k]
        y += q * back[1, k]
        z += q * back[2, k]
    w = -inverse_rho[phase[0, i]]
    push[0, i], push[1, i], push[2, i] = w * x, w * y, w * z


@ti.func
def relax(
    i,
    row: ti.template(),
    lone,
    lowest,
    relaxation,
    momentum,
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    total: ti.template(),
    density: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    warm: ti.template(),
    last: ti.template(),
    push: ti.template(),
):
    """One relaxation of the pressure of particle i, in dense fluid to no less than `lowest`, else 0.

    Gives what was left of r before, and whether the momentum helped, r (p - before).
    """
    r = source[i] + total[0, i] * push[0, i] + total[1, i] * push[1, i] + total[2, i] * push[2, i]
    for k in range(begin[i], end[i]):
        j = neighbour[k]
        r -= gradient[0, k] * push[0, j] + gradient[1, k] * push[1, j] + gradient[2, k] * push[2, j]
    d = diagonal[i]
    before = last[i]
    y = warm[row, i]
    least = ti.select((row == MOTION) & (density[i] > 1.0 - GAP), lowest, 0.0)
    p = ti.select(d > lone, ti.max(y + relaxation * r / ti.max(d, lone), least), 0.0)
    last[i] = p
    warm[row, i] = ti.max(p + momentum * (p - before), least)
    return ti.Vector([ti.abs(p - y) * d / relaxation, r * (p - before)])


@ti.func
def visit(
    work: ti.template(),
    stage: ti.template(),
    i,
    dt,
    lone,
    lowest,
    relaxation,
    momentum,
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    back: ti.template(),
    wall: ti.template(),
    flux: ti.template(),
    total: ti.template(),
    density: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    warm: ti.template(),
    last: ti.template(),
    push: ti.template(),
    v: ti.template(),
    pressure: ti.template(),
):
    """One of the four passes on particle i; gives its compression and progress, where the pass finds them."""
    found = ti.Vector([0.0, 0.0])
    if ti.static(work == PREPARE):
        last[i] = warm[stage, i]
        found[0] = prepare(
            stage, i, dt, inverse_rho, phase, begin, end, neighbour, gradient, wall, flux, total, v, density,
            diagonal, source, lone,
        )  # fmt: skip
        # The motion always takes an iteration, which begins with this.
        if ti.static(stage == MOTION):
            accelerate(
                False, i, stage, inverse_rho, phase, begin, end, neighbour, back, total, warm, last, push
            )
    if ti.static(work == ACCELERATE):
        accelerate(False, i, stage, inverse_rho, phase, begin, end, neighbour, back, total, warm, last, push)
    if ti.static(work == RELAX):
        found = relax(
            i, stage, lone, lowest, relaxation, momentum, begin, end, neighbour, gradient, total, density,
            diagonal, source, warm, last, push,
        )  # fmt: skip
    if ti.static(work == FINISH):
        accelerate(True, i, stage, inverse_rho, phase, begin, end, neighbour, back, total, warm, last, push)
        if ti.static(stage == MOTION):
            pressure[i] = last[i]
            for c in ti.static(range(3)):
                v[c, i] += dt * push[c, i]
    return found


@ti.func
def sweep(
    work: ti.template(),
    stage: ti.template(),
    n,
    dt,
    lone,
    lowest,
    relaxation,
    momentum,
    turn,
    crew: ti.template(),
    sums: ti.template(),
    inverse_rho: ti.template(),
    phase: ti.template(),
    begin: ti.template(),
    end: ti.template(),
    neighbour: ti.template(),
    gradient: ti.template(),
    back: ti.template(),
    wall: ti.template(),
    flux: ti.template(),
    total: ti.template(),
    density: ti.template(),
    diagonal: ti.template(),
    source: ti.template(),
    warm: ti.template(),
    last: ti.template(),
    push: ti.template(),
    v: ti.template(),
    pressure: ti.template(),
):
    """A pass over the pieces that this task takes; compressions are summed by piece."""
    piece = take(crew, turn)
    while piece < pieces(n):
        found = ti.Vector([0.0, 0.0])
        for i in range(first_of(piece), last_of(piece, n)):
            found += visit(
                work, stage, i, dt, lone, lowest, relaxation, momentum, inverse_rho, phase, begin, end,
                neighbour, gradient, back, wall, flux, total, density, diagonal, source, warm, last, push, v,
                pressure,
            )  # fmt: skip
        if ti.static(work == PREPARE or work == RELAX):
            sums[turn % 4 // 2 * 2, piece] = found[0]
            sums[turn % 4 // 2 * 2 + 1, piece] = found[1]
        piece = take(crew, turn)


@ti.func
def mean_of(turn, which, n, sums: ti.template()):
    """Mean over the particles of what was summed in a pass: 0 the compression, 1 the progress."""
    total = 0.0
    for piece in range(pieces(n)):
        total += sums[turn % 4 // 2 * 2 + which, piece]
    return total / n


@ti.func
def hastened(pace, helped):
    """The next pace, and the momentum of the next iteration; from the start again where it did not help."""
    faster = 0.5 * (1.0 + ti.sqrt(1.0 + 4.0 * pace * pace))
    momentum = (pace - 1.0) / faster
    if not helped:
        faster, momentum = 1.0, 0.0
    return faster, momentum


@ti.kernel
def solve(
    stage: ti.template(),
    n: ti.i32,
    dt: ti.f32,
    lone: ti.f32,
    lowest: ti.f32,
    relaxation: ti.f32,
    tolerance: ti.f32,
    least: ti.i32,
    most: ti.i32,
    tasks: ti.i32,
    stride: ti.i32,
    crew: i32_1d,
    sums: f32_2d,
    inverse_rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    back: f32_2d,
    wall: f32_2d,
    flux: f32_1d,
    total: f32_2d,
    density: f32_1d,
    diagonal: f32_1d,
    source: f32_1d,
    warm: f32_2d,
    last: f32_1d,
    push: f32_2d,
    v: f32_2d,
    pressure: f32_1d,
    report: f32_1d,
):
    """Prepare, iterate until the mean compression is at most `tolerance`; in the first stage v gets dt a.

    In the second, dt^2 `push` is the displacement, and there is none where it takes no iterations.
    report: iterations, mean compression that is left, and without any pressure.
    """
    for block in range(tasks * stride):
        if block % stride == 0:
            # Passes take turns 0 (prepare), 1, 2 (an iteration), 3, 4 (the next), ...
            turn, momentum, omega = 0, 0.0, relaxation
            sweep(
                PREPARE, stage, n, dt, lone, lowest, omega, momentum, turn, crew, sums, inverse_rho,
                phase, begin, end, neighbour, gradient, back, wall, flux, total, density, diagonal, source,
                warm, last, push, v, pressure,
            )  # fmt: skip
            meet(crew, tasks)
            error = mean_of(turn, 0, n, sums) * dt * dt
            if block == 0:
                report[2] = error
            working = stage == MOTION or error > tolerance
            pace, best = 1.0, ENDLESS
            while working:
                turn += 1
                if stage == DRIFT or turn > 1:
                    sweep(
                        ACCELERATE, stage, n, dt, lone, lowest, omega, momentum, turn, crew, sums,
                        inverse_rho, phase, begin, end, neighbour, gradient, back, wall, flux, total, density,
                        diagonal, source, warm, last, push, v, pressure,
                    )  # fmt: skip
                    meet(crew, tasks)
                turn += 1
                sweep(
                    RELAX, stage, n, dt, lone, lowest, omega, momentum, turn, crew, sums, inverse_rho,
                    phase, begin, end, neighbour, gradient, back, wall, flux, total, density, diagonal,
                    source, warm, last, push, v, pressure,
                )  # fmt: skip
                meet(crew, tasks)
                error = mean_of(turn, 0, n, sums) * dt * dt
                pace, momentum = hastened(pace, mean_of(turn, 1, n, sums) >= 0.0 and error < GROWTH * best)
                if error > GROWTH * best:
                    omega *= SLOWER
                    best = error
                best = ti.min(best, error)
                working = turn // 2 < most and (error > tolerance or turn // 2 < least)
            if turn > 0:
                turn += 1
                sweep(
                    FINISH, stage, n, dt, lone, lowest, omega, momentum, turn, crew, sums, inverse_rho,
                    phase, begin, end, neighbour, gradient, back, wall, flux, total, density, diagonal,
                    source, warm, last, push, v, pressure,
                )  # fmt: skip
            if block == 0:
                report[0] = turn // 2
                report[1] = error


@ti.kernel
def launch(
    work: ti.template(),
    stage: ti.template(),
    n: ti.i32,
    dt: ti.f32,
    lone: ti.f32,
    lowest: ti.f32,
    relaxation: ti.f32,
    momentum: ti.f32,
    sums: f32_2d,
    inverse_rho: f32_1d,
    phase: i32_2d,
    begin: i32_1d,
    end: i32_1d,
    neighbour: i32_1d,
    gradient: f32_2d,
    back: f32_2d,
    wall: f32_2d,
    flux: f32_1d,
    total: f32_2d,
    density: f32_1d,
    diagonal: f32_1d,
    source: f32_1d,
    warm: f32_2d,
    last: f32_1d,
    push: f32_2d,
    v: f32_2d,
    pressure: f32_1d,
):
    """One pass by itself, for back ends on which tasks cannot meet."""
    for piece in range(pieces(n)):
        found = ti.Vector([0.0, 0.0])
        for i in range(first_of(piece), last_of(piece, n)):
            found += visit(
                work, stage, i, dt, lone, lowest, relaxation, momentum, inverse_rho, phase, begin, end,
                neighbour, gradient, back, wall, flux, total, density, diagonal, source, warm, last, push, v,
                pressure,
            )  # fmt: skip
        sums[0, piece], sums[1, piece] = found[0], found[1]
