"""Tubes: how kernels walk the cells of a NeighborGrid (see grid.py), in pieces that tasks take in turn.

A row of cells along x and its neighbour rows are gathered into scratch once, so that each particle's
candidates lie in one run that is read in vectors. `shape` and `geometry` describe the grid to kernels.
"""

from tianim.lang import i32_1d, ti

# Candidates are read in vectors of 8; what is past the end of a tube lies this far away [m].
LANES = 8
FAR = 1e9
# What a tube holds: places and velocities, a tag too, or places and a tag.
MOTIONS, TAGGED_MOTIONS, PLACES = 0, 1, 2
# Pieces of a walk for each task, taken in turn: one that is held up by another process does fewer.
PIECES = 8

# Entries of the two small arrays that describe a grid to kernels.
NX, NY, NZ, COUNT, TASKS, STRIDE, CAPACITY, PERIODIC, TURN = range(9)
LOWER, INVERSE, LOW_SIDE, HIGH_SIDE = 0, 3, 6, 9  # each three floats


@ti.func
def share(n, t, tasks):
    """First of the n items that task t of `tasks` takes."""
    return ti.cast(ti.cast(n, ti.i64) * t // tasks, ti.i32)


@ti.kernel
def largest_tube(dimension: ti.template(), shape: i32_1d, start: i32_1d) -> ti.i32:
    """Candidates in the fullest tube, so that scratch can be made large enough before the walk."""
    nx, ny, nz = shape[NX], shape[NY], shape[NZ]
    largest = 0
    ti.loop_config(serialize=True)
    for row in range(ny * nz):
        cy, cz = row % ny, row // ny
        total = 0
        for dz in range(ti.static(-1 if dimension == 3 else 0), ti.static(2 if dimension == 3 else 1)):
            for dy in range(-1, 2):
                first = (((cz + dz + nz) % nz) * ny + (cy + dy + ny) % ny) * nx
                total += 2 * start[first + nx] - start[first + nx - 2] + start[first + 2] - 2 * start[first]
        ti.atomic_max(largest, total)
    return largest


@ti.func
def pieces(shape: ti.template()):
    """Pieces that a walk is cut into."""
    return shape[TASKS] * PIECES


@ti.func
def take_turn(shape: ti.template()):
    """The next piece of a walk that no task has taken yet; `shape[TURN]` is 0 when a walk begins."""
    return ti.atomic_add(shape[TURN], 1)


@ti.func
def first_row(piece, shape: ti.template(), start: ti.template()):
    """First row of cells of a piece of a walk: rows are shared out so that particles are even."""
    nx = shape[NX]
    rows = shape[NY] * shape[NZ]
    wanted = share(shape[COUNT], piece, pieces(shape))
    low, high = 0, rows
    if piece < pieces(shape):
        while low < high:
            middle = (low + high) // 2
            if start[middle * nx] < wanted:
                low = middle + 1
            else:
                high = middle
    else:
        low = rows
    return low


@ti.func
def gather_tube(
    dimension: ti.template(),
    content: ti.template(),
    t,
    row,
    shape: ti.template(),
    geometry: ti.template(),
    start: ti.template(),
    x: ti.template(),
    v: ti.template(),
    tag: ti.template(),
    scratch: ti.template(),
    offset: ti.template(),
):
    """Copy the row of cells and its neighbour rows into scratch, slice by slice along x.

    Slices 0 to 3 hold the columns n_x - 2, n_x - 1, 0, 1, which meet at the seam, and the slices
    from 4 on all columns; `slice_of` says which one has a column with both its neighbours. In a
    slice the row's own cell comes first. scratch[0:3] is the position, [3:6] the velocity, [6] the
    tag, as `content` says; offset[t, s] is where slice s starts.
    """
    nx, ny, nz = shape[NX], shape[NY], shape[NZ]
    cy, cz = row % ny, row // ny
    if cy == ny - 1:
        cy = -1
    if ti.static(dimension == 3) and cz == nz - 1:
        cz = -1
    m = t * shape[CAPACITY]
    for s in range(nx + 4):
        offset[t, s] = m
        column = s - 4
        shift_x = 0.0
        if s < 2:
            column = nx - 2 + s
            shift_x = geometry[HIGH_SIDE]
        elif s < 4:
            column = s - 2
            shift_x = geometry[LOW_SIDE]
        for k in range(ti.static(9 if dimension == 3 else 3)):
            yy, zz = cy, cz
            if ti.static(dimension == 3):
                q = (k + 4) % 9
                yy += q % 3 - 1
                zz += q // 3 - 1
            else:
                yy += (k + 1) % 3 - 1
            shift_y, shift_z = 0.0, 0.0
            if yy < 0:
                yy += ny
                shift_y = geometry[HIGH_SIDE + 1]
            elif cy <= 0:
                shift_y = geometry[LOW_SIDE + 1]
            if ti.static(dimension == 3):
                if zz < 0:
                    zz += nz
                    shift_z = geometry[HIGH_SIDE + 2]
                elif cz <= 0:
                    shift_z = geometry[LOW_SIDE + 2]
            c = (zz * ny + yy) * nx + column
            begin, end = start[c], start[c + 1]
            move = m - begin
            for j in range(begin, end):
                scratch[0, j + move] = x[0, j] - shift_x
                scratch[1, j + move] = x[1, j] - shift_y
                if ti.static(dimension == 3):
                    scratch[2, j + move] = x[2, j] - shift_z
                if ti.static(content != PLACES):
                    scratch[3, j + move] = v[0, j]
                    scratch[4, j + move] = v[1, j]
                    if ti.static(dimension == 3):
                        scratch[5, j + move] = v[2, j]
                if ti.static(content != MOTIONS):
                    scratch[6, j + move] = ti.cast(tag[0, j], ti.f32)
            m += end - begin
    offset[t, nx + 4] = m
    for k in range(LANES):
        scratch[0, m + k] = FAR


@ti.func
def slice_of(column, nx):
    """The slice of a tube that holds a column between both its neighbours."""
    s = column + 4
    if column == 0:
        s = 2
    if column == nx - 1:
        s = 1
    return s


@ti.func
def rounded(count):
    """`count` rounded up to whole vectors: the loop needs no scalar rest, the body masks j < end."""
    return (count + (LANES - 1)) & ~(LANES - 1)
