"""The fail-safe of self-contact: what still meets moves as one rigid body, or not at all.

Points that meet form zones; each keeps its momentum and its angular momentum about its centre (Provot 1997;
Bridson, Fedkiw, Anderson 2002, doi:10.1145/566570.566623; Harmon et al. 2008, doi:10.1145/1360612.1360622):

    x' = c + V + R(w) (x - c),    M V = sum m u,    I w = sum m r x u

c the centre at the start of the step, u the ways in it, r = x - c. Zones grow by what meets them. What is
rigid does not meet itself, and what stays where it began meets nothing, so that the last resort always works
unless pins or bodies force points through.
"""

from collections.abc import Callable

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

# Points that are held count as so much heavier than the others of their zone.
HELD = 1e6
# Times that zones may grow, and then that what they hold stays where it began.
MOST_ZONES, MOST_STOPS = 12, 50


def zones_of(count: int, met: Ints) -> list[NDArray[np.int64]]:
    """The points of each zone: those that are linked by the quadruples `met` (m, 4)."""
    a, b = met[:, [0, 1, 2]].ravel(), met[:, [1, 2, 3]].ravel()
    graph = scipy.sparse.coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(count, count))
    _, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    points = np.unique(met)
    order = points[np.argsort(label[points], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def rigid(start: Floats, end: Floats, mass: Floats, held: NDArray[np.bool_]) -> Floats:
    """Where the points of a zone go as a rigid body; those that are held go where they go."""
    m = np.where(held, HELD * mass, mass)
    centre, u = m @ start / m.sum(), end - start
    shift, r = m @ u / m.sum(), start - centre
    spin = (m[:, None] * np.cross(r, u)).sum(axis=0)
    inertia = np.einsum("i,ij,ij->", m, r, r) * np.eye(3) - np.einsum("i,ij,ik->jk", m, r, r)
    turn = np.linalg.pinv(inertia, rcond=1e-9, hermitian=True) @ spin
    moved = centre + shift + scipy.spatial.transform.Rotation.from_rotvec(turn).apply(r)
    return np.where(held[:, None], end, moved)


def keep_apart(
    start: Floats, wanted: Floats, mass: Floats, held: NDArray[np.bool_], meets: Callable[[Floats], Ints]
) -> tuple[int, bool]:
    """Change where points go from `start`, `wanted` (n, 3), until nothing meets on the way.

    `meets` takes places, makes them those of the points, and gives the quadruples that meet, (m, 4). Returns
    how many points the zones have, and whether nothing meets any more.
    """
    met = meets(wanted)
    for k in range(MOST_ZONES + MOST_STOPS):
        now = wanted.copy()
        for zone in zones_of(len(start), met):
            if k < MOST_ZONES:
                now[zone] = rigid(start[zone], wanted[zone], mass[zone], held[zone])
            else:
                now[zone] = np.where(held[zone, None], wanted[zone], start[zone])
        found = meets(now)
        if len(found) == 0:
            return len(np.unique(met)), True
        more = np.unique(np.concatenate([met, found]), axis=0)
        if k >= MOST_ZONES and len(more) == len(met):
            break
        met = more
    return len(np.unique(met)), False
