"""Our geometry as Open3D's: meshes for its renderer, points, lines and meshes for its window."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.view.canvas import Geometry, Triangles
from tianim.view.colormap import ENTRIES, to_srgb
from tianim.view.shade import CREASE

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Corners:
    """Corners of triangles, each on its own: position, normal, linear colour, all (3 m, 3)."""

    position: Float
    normal: Float
    color: Float
    triangles: NDArray[np.int32]


def corners_of(geometry: Geometry, eye: Float | None = None) -> Corners:
    """All triangles, with colours and normals of the side that `eye` sees; without an eye, of the front."""
    ours = geometry.triangles
    corners, normals = ours.position[ours.triangles], corner_normals(ours)
    rows = ours.tone[ours.triangles].astype(int)
    if eye is not None:
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        behind = np.einsum("mk,mk->m", across, eye - corners[:, 0]) < 0.0
        rows = rows + np.where(behind, ENTRIES, 0)[:, None]
        normals = np.where(behind[:, None, None], -normals, normals)
    colors = geometry.colors[rows] * np.minimum(ours.tint[ours.triangles], 1.5)[..., None]
    numbers = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return Corners(_column(corners), _column(normals), _column(colors), numbers)


def _column(values: NDArray) -> Float:
    return np.ascontiguousarray(values.reshape(-1, 3), dtype=np.float32)


def lit_mesh(open3d: ModuleType, geometry: Geometry, eye: Float) -> Any:
    """All triangles as `eye` sees them, for the renderer, which takes linear colours.

    A tensor mesh: with others, redrawing a mesh that changes hangs (Open3D 0.20, software Vulkan).
    """
    corners, tensor = corners_of(geometry, eye), open3d.core.Tensor
    mesh = open3d.t.geometry.TriangleMesh()
    mesh.vertex.positions, mesh.vertex.normals = tensor(corners.position), tensor(corners.normal)
    mesh.vertex.colors = tensor(corners.color)
    mesh.triangle.indices = tensor(corners.triangles)
    return mesh


def _window_mesh(open3d: ModuleType, geometry: Geometry) -> Any:
    """All triangles for the window, which takes encoded colours."""
    corners, vectors = corners_of(geometry), open3d.utility.Vector3dVector
    mesh = open3d.geometry.TriangleMesh(
        vectors(corners.position.astype(np.float64)), open3d.utility.Vector3iVector(corners.triangles)
    )
    mesh.vertex_normals = vectors(corners.normal.astype(np.float64))
    mesh.vertex_colors = vectors(to_srgb(corners.color).astype(np.float64))
    return mesh


def corner_normals(mesh: Triangles) -> Float:
    """Normals (m, 3 corners, 3): smooth, but those of the triangle at sharp edges, as in our own shading."""
    a, b, c = (mesh.position[mesh.triangles[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-30)
    smooth = mesh.normal[mesh.triangles]
    agree = np.einsum("mkc,mc->mk", smooth, flat)[..., None]
    turned = np.where(agree < 0.0, -smooth, smooth)
    return np.where(np.abs(agree) < CREASE, flat[:, None], turned).astype(np.float32)


def window_shapes(open3d: ModuleType, geometry: Geometry) -> list[Any]:
    """Open3D's points, lines and meshes for what we would draw."""
    vectors, colors = open3d.utility.Vector3dVector, to_srgb(geometry.colors).astype(np.float64)
    shapes = []
    clouds = [(geometry.spheres.position, geometry.spheres.tone)]
    clouds += [(blend.head, blend.tone) for blend in geometry.blends]
    for position, tone in clouds:
        if len(position):
            cloud = open3d.geometry.PointCloud(vectors(position.astype(np.float64)))
            cloud.colors = vectors(colors[tone.astype(int)])
            shapes.append(cloud)
    sticks = geometry.sticks
    if len(sticks.segments):
        lines = open3d.geometry.LineSet(
            vectors(sticks.position.astype(np.float64)), open3d.utility.Vector2iVector(sticks.segments)
        )
        lines.colors = vectors(colors[sticks.tone.astype(int)])
        shapes.append(lines)
    if len(geometry.triangles.triangles):
        shapes.append(_window_mesh(open3d, geometry))
    return shapes
