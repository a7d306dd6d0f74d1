"""What a Gauss-Seidel solver takes at once: lines of springs, and colours of what shares no point.

Springs that follow each other straight on make a line, which is solved as a whole; a sheet falls into its
rows, its columns and its diagonals. Two of one colour share no point, so that all of a colour are solved side
by side. Greedy: each, in order, takes the first colour that none of its points has; those of large colours
then go to the smallest that is free, so that cores share the work of each.

Limits: in Python, some us a spring; it is done once.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# A line goes on with the spring that turns least, by less than this cosine says: 45 deg.
STRAIGHT = 0.7


def in_colours(points: Sequence[Sequence[int]], count: int) -> tuple[Ints, Ints]:
    """Order that puts colours together, and where each begins, (colours + 1,).

    `points` < `count` are those of each of what is coloured. Within a colour the order stays.
    """
    used = [0] * count  # a bit for each colour
    colour, sizes = [0] * len(points), list[int]()
    for k, row in enumerate(points):
        taken = 0
        for i in row:
            taken |= used[i]
        free = ~taken & (taken + 1)
        for i in row:
            used[i] |= free
        colour[k] = free.bit_length() - 1
        if colour[k] == len(sizes):
            sizes.append(0)
        sizes[colour[k]] += len(row)
    for k, row in enumerate(points):
        own, taken = colour[k], 0
        for i in row:
            taken |= used[i]
        better = [c for c, size in enumerate(sizes) if size + len(row) < sizes[own] and not taken >> c & 1]
        if better:
            other = min(better, key=sizes.__getitem__)
            for i in row:
                used[i] = used[i] & ~(1 << own) | (1 << other)
            sizes[own] -= len(row)
            sizes[other] += len(row)
            colour[k] = other
    order = np.argsort(np.array(colour, np.int64), kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(np.array(colour, np.int64)))])
    return order.astype(np.int32), starts.astype(np.int32)


def lines_of(ends: Ints, x: Floats) -> list[tuple[list[int], list[int]]]:
    """Springs (s, 2) as lines: of each its springs by number, and its points, one more, all different."""
    at: list[list[int]] = [[] for _ in range(len(x))]
    pairs = ends.tolist()
    for s, (a, b) in enumerate(pairs):
        at[a].append(s)
        at[b].append(s)
    d = x[ends[:, 1]] - x[ends[:, 0]]
    heading = (d / np.maximum(np.linalg.norm(d, axis=1), 1e-300)[:, None]).tolist()
    free, lines = [True] * len(pairs), []

    def follow(springs: list[int], points: list[int], met: set[int], sign: float) -> None:
        """Go on from the last of `points`; `sign` says whether the last spring is headed there."""
        while True:
            here, (ux, uy, uz) = points[-1], heading[springs[-1]]
            best, chosen = STRAIGHT, -1
            for s in at[here]:
                if free[s]:
                    a, b = pairs[s]
                    hx, hy, hz = heading[s]
                    cosine = sign * (ux * hx + uy * hy + uz * hz) * (1.0 if a == here else -1.0)
                    if cosine > best and (b if a == here else a) not in met:
                        best, chosen = cosine, s
            if chosen < 0:
                return
            free[chosen] = False
            a, b = pairs[chosen]
            sign = 1.0 if a == here else -1.0
            springs.append(chosen)
            points.append(b if a == here else a)
            met.add(points[-1])

    for s, (a, b) in enumerate(pairs):
        if free[s]:
            free[s] = False
            met = {a, b}
            springs, points = [s], [a, b]
            follow(springs, points, met, 1.0)
            back_springs, back_points = [s], [b, a]
            follow(back_springs, back_points, met, -1.0)
            lines.append((back_springs[:0:-1] + springs, back_points[:1:-1] + points))
    return lines
