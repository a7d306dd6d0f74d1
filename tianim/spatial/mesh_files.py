"""Triangle meshes from files, through trimesh: points joined, checked, kept in a small cache."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.params import LARGE

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off")
# Meshes kept in memory: the bodies of a scene are read when checked and again when built.
CACHED_MESHES = 8

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TriangleData:
    """A mesh whose points are all different, in the file's unit.

    vertices   (n, 3) f64
    triangles  (m, 3) i32
    """

    vertices: Floats
    triangles: NDArray[np.int32]

    @property
    def lower(self) -> Floats:
        """Least corner of the bounding box, (3,)."""
        return np.asarray(self.vertices.min(axis=0))

    @property
    def extent(self) -> Floats:
        """Lengths of the bounding box, (3,)."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @cached_property
    def _edges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """How often each edge is used, and how much oftener one way than the other."""
        directed = self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
        forward = np.where(directed[:, 0] < directed[:, 1], 1, -1)
        code = directed.min(axis=1) * len(self.vertices) + directed.max(axis=1)
        _, edge, uses = np.unique(code, return_inverse=True, return_counts=True)
        return uses, np.bincount(edge, weights=forward, minlength=len(uses)).astype(np.int64)

    @property
    def open_edges(self) -> int:
        """Edges that an odd number of triangles share; 0 where the mesh is watertight."""
        return int(np.count_nonzero(self._edges[0] % 2))

    @property
    def is_oriented(self) -> bool:
        """True where neighbouring triangles agree on which side is out."""
        return not self._edges[1].any()


@dataclass(frozen=True)
class _FileData:
    """What a file says, (n, 3) points and (m, 3) triangles, and one point of each place."""

    points: Floats
    faces: NDArray[np.int32]
    kept: NDArray[np.int64]
    mesh: TriangleData


def read_mesh(path: Path) -> TriangleData:
    """The triangles of a mesh file. SceneError names what is wrong with it."""
    return _cached(path).mesh


def read_key(path: Path, first: Path) -> TriangleData:
    """A mesh with the triangles of the mesh in `first`. SceneError where it has others.

    Points are joined as in `first`, also where others happen to meet in this key.
    """
    key, start = _cached(path), _cached(first)
    if key.points.shape != start.points.shape or not np.array_equal(key.faces, start.faces):
        raise SceneError(
            f"{path}: {len(key.points)} points and {len(key.faces)} triangles, not the same mesh as "
            f"{first} ({len(start.points)} and {len(start.faces)})"
        )
    return TriangleData(key.points[start.kept], start.mesh.triangles)


def _cached(path: Path) -> _FileData:
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from error


@lru_cache(maxsize=CACHED_MESHES)
def _read(path: Path, stamp: int) -> _FileData:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise SceneError(f"{path}: not a mesh file; must be one of {', '.join(MESH_SUFFIXES)}")
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        points = np.array(mesh.vertices, dtype=np.float64) + 0.0  # -0.0 is the same place as 0.0
        faces = np.array(mesh.faces, dtype=np.int32)
    except OSError:
        raise
    except Exception as error:  # trimesh's readers raise whatever their parsing runs into
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise SceneError(f"{path}: not a readable {path.suffix} mesh ({reason})") from error
    if len(faces) == 0:
        raise SceneError(f"{path}: holds no triangles")
    if not (np.abs(points) <= LARGE).all():
        raise SceneError(f"{path}: holds coordinates that are not finite or beyond {LARGE:g}")
    if faces.min() < 0 or faces.max() >= len(points):
        raise SceneError(f"{path}: a triangle names a point that is not there")
    return _join(points, faces, path)


def _join(points: Floats, faces: NDArray[np.int32], path: Path) -> _FileData:
    """One point a place, and no triangle that names a place twice."""
    vertices, kept, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    triangles = place.reshape(-1)[faces].astype(np.int32)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) == 0:
        raise SceneError(f"{path}: all triangles are points or lines")
    return _FileData(points, faces, kept, TriangleData(vertices, triangles))
