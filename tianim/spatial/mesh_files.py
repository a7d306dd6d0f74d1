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
    place: NDArray[np.int64]
    uv: NDArray[np.float32] | None


def read_mesh(path: Path) -> TriangleData:
    """The triangles of a mesh file. SceneError names what is wrong with it."""
    return _cached(path).mesh


@dataclass(frozen=True)
class Shown:
    """A mesh as its file has it: `place` (n,) of each point among the vertices of `read_mesh`.

    triangles (m, 3) of the file's points, those of `read_mesh` in the same order; uv (n, 2), None without
    """

    place: NDArray[np.int64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32] | None


def read_shown(path: Path) -> Shown:
    """Points, triangles and texture coordinates in the order of the file."""
    data = _cached(path)
    a, b, c = data.place[data.faces].T
    return Shown(data.place, data.faces[(a != b) & (b != c) & (c != a)], data.uv)


def painted_values(path: Path, name: str) -> Floats:
    """A number that a ply file has for each point, at the vertices of `read_mesh`. SceneError without it."""
    data = _cached(path)
    import meshio

    fields = {} if path.suffix.lower() != ".ply" else meshio.read(path).point_data
    known = sorted(field for field, values in fields.items() if np.ndim(values) == 1)
    if name not in known:
        raise SceneError(
            f"{path}: has no {name!r} painted on its points; it has {', '.join(known) or 'none'}"
        )
    values = np.asarray(fields[name], np.float64)
    if not np.isfinite(values).all():
        raise SceneError(f"{path}: {name} is not finite at point {int(np.argmin(np.isfinite(values)))}")
    return np.asarray(values[data.kept])


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
    uv = getattr(mesh.visual, "uv", None)
    return _join(points, faces, path, None if uv is None else np.array(uv, np.float32))


def _join(points: Floats, faces: NDArray[np.int32], path: Path, uv: NDArray[np.float32] | None) -> _FileData:
    """One point a place, and no triangle that names a place twice."""
    vertices, kept, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    triangles = place.reshape(-1)[faces].astype(np.int32)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    if len(triangles) == 0:
        raise SceneError(f"{path}: all triangles are points or lines")
    return _FileData(points, faces, kept, TriangleData(vertices, triangles), place.reshape(-1), uv)
