"""How far places are from the walls at the start, and how that is said in an error."""

import numpy as np
from numpy.typing import NDArray

from tianim.spatial.bodies import Bodies, query_bodies
from tianim.spatial.body_params import MeshSequence, TriangleMesh, sequence_files
from tianim.spatial.mesh_files import read_mesh
from tianim.system import Bounds

Floats = NDArray[np.float64]

# The distance grid of a mesh is true to this part of its cell (spatial/distance_grid.py).
MESH_ERROR = 0.1


def room_in_bounds(x: Floats, bounds: Bounds, dimension: int) -> Floats:
    """Distance of points (n, 3) from the nearest face [m], negative outside; infinite where open."""
    if bounds.lower is None or bounds.upper is None:
        return np.full(len(x), np.inf)
    flat = x[:, :dimension]
    lower, upper = np.array(bounds.lower)[:dimension], np.array(bounds.upper)[:dimension]
    return np.asarray(np.minimum(flat - lower, upper - flat).min(axis=1))


def distance_error(bodies: Bodies) -> float:
    """How much a distance from the bodies may be wrong [m]."""
    worst = 0.0
    for body in bodies.params.values():
        if isinstance(body, TriangleMesh | MeshSequence):
            path = body.file if isinstance(body, TriangleMesh) else sequence_files(body.files)[0]
            cell = float(read_mesh(path).extent.max()) * body.scale / body.resolution
            worst = max(worst, MESH_ERROR * cell)
    return worst


def nearest_body(bodies: Bodies, x: Floats) -> str:
    """Name of the body that is nearest to a point (3,), or that it is deepest in."""
    point, table = np.array([x], np.float32), bodies.table.to_numpy()
    hits, velocity = np.zeros((1, 4), np.float32), np.zeros((1, 3), np.float32)
    distances = []
    for b in range(bodies.count):
        query_bodies(np.ascontiguousarray(table[b : b + 1]), bodies.samples, 1, point, hits, velocity)
        distances.append(hits[0, 3])
    return bodies.names[int(np.argmin(distances))]


def as_text(x: Floats) -> str:
    """A place, for people."""
    return f"({', '.join(f'{value:.4g}' for value in x)})"
