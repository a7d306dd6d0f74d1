"""Constraints in colours: two of one colour share no point, so that all of a colour are solved at once.

Greedy: each constraint, in order, takes the first colour that none of its points has. Those of large colours
then go to the smallest that is free, so that cores share the work of each. In order means that pieces built
row by row need few: a sheet's springs take 8, as many as meet at a point.

Limits: in Python, 1 us a constraint; they are coloured once.
"""

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]


def in_colours(points: Ints, count: int) -> tuple[Ints, Ints]:
    """Order of the constraints (m,) that puts colours together, and where each begins, (colours + 1,).

    `points` (m, p) < `count` are those of each constraint. Within a colour the order stays.
    """
    used = [0] * count  # a bit for each colour
    rows = points.tolist()
    sizes: list[int] = []
    colour = [0] * len(rows)
    for k, row in enumerate(rows):
        taken = 0
        for i in row:
            taken |= used[i]
        free = ~taken & (taken + 1)
        for i in row:
            used[i] |= free
        colour[k] = free.bit_length() - 1
        if colour[k] == len(sizes):
            sizes.append(0)
        sizes[colour[k]] += 1
    for k, row in enumerate(rows):
        own, taken = colour[k], 0
        for i in row:
            taken |= used[i]
        open_to_it = [c for c, size in enumerate(sizes) if size < sizes[own] - 1 and not taken >> c & 1]
        if open_to_it:
            other = min(open_to_it, key=sizes.__getitem__)
            for i in row:
                used[i] = used[i] & ~(1 << own) | (1 << other)
            sizes[own] -= 1
            sizes[other] += 1
            colour[k] = other
    order = np.argsort(np.array(colour, np.int64), kind="stable")
    return order.astype(np.int32), np.cumsum([0, *sizes]).astype(np.int32)
