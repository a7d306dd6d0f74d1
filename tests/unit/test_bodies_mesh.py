"""Mesh bodies: distance grids beside formulas, files that are not meshes, sequences."""

import time as clock
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from tianim.errors import SceneError
from tianim.frame import Lines, Mesh
from tianim.math.rotations import from_euler, rotate, rotate_back
from tianim.spatial.bodies import Bodies, BodyParams, Box, MeshSequence, Sphere, TriangleMesh
from tianim.spatial.distance_grid import MARGIN, grid_about, sample_distance
from tianim.spatial.mesh_files import TriangleData, read_mesh

# Sweeps leave a sample on the second nearest triangle here and there (distance_grid's docstring).
SWEEP = 0.1
# Trilinear values between exact samples of a smooth distance with curvature 1/r err by
# cell^2 / (8 r) an axis; next to a crease by up to half a cell.
CREASE = 0.5
# Processor time allowed for 5,000 triangles at 64 cells [s]; measured 0.5 s.
BUILD_SECONDS = 2.0

Floats = NDArray[np.float64]
POSE: dict[str, Any] = {"position": (0.3, 0.2, -0.5), "rotation": (20.0, 30.0, 40.0)}


def data(mesh: Any) -> TriangleData:
    return TriangleData(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int32))


def samples(
    mesh: TriangleData, resolution: int, signed: bool = True
) -> tuple[Floats, NDArray[np.float32], float]:
    """Where the grid's samples are, what they say, and the cell's length."""
    grid = grid_about(mesh.lower, mesh.extent, resolution)
    place = np.stack(np.meshgrid(*[np.arange(n) for n in grid.size], indexing="ij"), axis=-1).reshape(-1, 3)
    return grid.lower + grid.cell * place, sample_distance(mesh, grid, 1.0, signed), grid.cell


def box_distance(p: Floats, size: Floats) -> Floats:
    q = np.abs(p) - 0.5 * size
    return np.asarray(np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0))


def test_samples_of_a_box_are_exact_although_rays_meet_its_edges() -> None:
    size = np.array([1.0, 2.0, 3.0])
    x, distance, cell = samples(data(trimesh.creation.box(size)), 24)
    np.testing.assert_allclose(distance, box_distance(x, size), atol=1e-5 * cell)


def test_samples_of_a_turned_box_are_exact() -> None:
    size, q = np.array([1.0, 2.0, 3.0]), from_euler((17.0, 40.0, 80.0))
    mesh = data(trimesh.creation.box(size))
    x, distance, cell = samples(TriangleData(rotate(q, mesh.vertices), mesh.triangles), 24)
    exact = box_distance(rotate_back(q, x), size)
    np.testing.assert_allclose(np.abs(distance), np.abs(exact), atol=SWEEP * cell)
    surely = np.abs(exact) > 1e-6
    assert (np.sign(distance) == np.sign(exact))[surely].all()


def test_samples_of_a_torus_are_near_the_formula() -> None:
    ring, tube = 1.0, 0.35
    mesh = trimesh.creation.torus(ring, tube, major_sections=96, minor_sections=64)
    x, distance, cell = samples(data(mesh), 32)
    exact = np.hypot(np.hypot(x[:, 0], x[:, 1]) - ring, x[:, 2]) - tube
    # Chords of 96 and 64 pieces lie up to r (1 - cos(pi / n)) inside the curve.
    flat = (ring + tube) * (1 - np.cos(np.pi / 96)) + tube * (1 - np.cos(np.pi / 64))
    np.testing.assert_allclose(distance, exact, atol=SWEEP * cell + flat)
    surely = np.abs(exact) > flat
    assert (np.sign(distance) == np.sign(exact))[surely].all()


def test_parts_that_overlap_are_inside() -> None:
    """Rays cross four surfaces in the common part; counting parity alone would call it outside."""
    second = trimesh.creation.box((1.0, 1.0, 1.0))
    second.apply_translation((0.43, 0.37, 0.21))
    x, distance, _ = samples(
        data(trimesh.util.concatenate([trimesh.creation.box((1.0, 1.0, 1.0)), second])), 24
    )
    exact = np.minimum(box_distance(x, np.ones(3)), box_distance(x - (0.43, 0.37, 0.21), np.ones(3)))
    surely = np.abs(exact) > 1e-6
    assert (np.sign(distance) == np.sign(exact))[surely].all()


def test_triangles_that_disagree_on_out_still_have_an_inside() -> None:
    mesh = data(trimesh.creation.box((1.0, 1.0, 1.0)))
    mixed = mesh.triangles.copy()
    mixed[::3] = mixed[::3, ::-1]
    assert not TriangleData(mesh.vertices, mixed).is_oriented
    x, distance, _ = samples(TriangleData(mesh.vertices, mixed), 16)
    exact = box_distance(x, np.ones(3))
    surely = np.abs(exact) > 1e-6
    assert (np.sign(distance) == np.sign(exact))[surely].all()


def saved(folder: Path, mesh: Any, name: str) -> Path:
    path = folder / name
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".off"])
def test_a_mesh_of_a_sphere_acts_like_a_sphere(tmp_path: Path, suffix: str) -> None:
    file = saved(tmp_path, trimesh.creation.icosphere(subdivisions=4), f"ball{suffix}")
    ball = Bodies({"b": TriangleMesh(file=file, scale=1.5, resolution=32, **POSE)})
    exact = Bodies({"b": Sphere(radius=1.5, **POSE)})
    x = np.random.default_rng(2).uniform(-5.0, 5.0, (4000, 3))
    distance, normal, _ = ball.distance(x)
    expected, direction, _ = exact.distance(x)
    local = rotate_back(from_euler(POSE["rotation"]), x - POSE["position"])
    cell = 3.0 / 32
    sampled = np.abs(local).max(axis=1) < 1.5 + MARGIN * cell
    assert 100 < sampled.sum() < 3000
    # The kink at the centre: half a cell along each axis.
    np.testing.assert_allclose(distance[sampled], expected[sampled], atol=CREASE * np.sqrt(3) * cell)
    # Elsewhere: facets lie up to 0.001 r inside, trilinear 3 cell^2 / (8 r).
    smooth = sampled & (expected > -1.0)
    np.testing.assert_allclose(distance[smooth], expected[smooth], atol=0.05 * cell)
    np.testing.assert_allclose(normal[smooth], direction[smooth], atol=cell / 1.5)
    # Outside the grid: an upper bound, see `_mesh`.
    far = distance[~sampled] / expected[~sampled]
    assert far.min() > 0.99
    assert far.max() < 1.06
    assert (normal * direction).sum(axis=1)[~sampled].min() > 0.98


def test_distance_changes_smoothly_across_the_border_of_the_grid(tmp_path: Path) -> None:
    file = saved(tmp_path, trimesh.creation.box((1.0, 1.0, 1.0)), "box.ply")
    bodies = Bodies({"b": TriangleMesh(file=file, resolution=16)})
    x = np.zeros((400, 3))
    x[:, 0] = np.linspace(0.4, 3.0, 400)
    x[:, 1] = 0.2
    distance, normal, _ = bodies.distance(x)
    np.testing.assert_allclose(distance, x[:, 0] - 0.5, atol=1e-5)
    np.testing.assert_allclose(normal, np.tile([1.0, 0.0, 0.0], (400, 1)), atol=1e-5)


def open_box() -> trimesh.Trimesh:
    mesh = trimesh.creation.box((1.0, 1.0, 1.0))
    return trimesh.Trimesh(mesh.vertices, mesh.faces[2:])


def test_an_open_mesh_is_refused_or_a_shell(tmp_path: Path) -> None:
    file = saved(tmp_path, open_box(), "open.ply")
    with pytest.raises(ValidationError, match=r"open\.ply is not watertight \(4 open edges\).*thickness"):
        TriangleMesh(file=file)
    with pytest.raises(ValidationError, match=r"thickness 0.01 m: must be at least a cell"):
        TriangleMesh(file=file, thickness=0.01)
    bodies = Bodies({"b": TriangleMesh(file=file, thickness=0.1, resolution=32)})
    assert bodies.distance([[0.0, 0.0, 0.0]])[0][0] == pytest.approx(0.4, abs=CREASE / 32)


def test_a_mesh_container_is_the_solid_with_the_other_sign(tmp_path: Path) -> None:
    file = saved(tmp_path, trimesh.creation.box((1.0, 2.0, 1.5)), "tank.ply")
    x = np.random.default_rng(3).uniform(-1.5, 1.5, (500, 3))
    solid, solid_normal, _ = Bodies({"b": TriangleMesh(file=file, resolution=16, **POSE)}).distance(x)
    tank = Bodies({"b": TriangleMesh(file=file, resolution=16, inside=True, **POSE)})
    distance, normal, _ = tank.distance(x)
    np.testing.assert_array_equal(distance, -solid)
    np.testing.assert_array_equal(normal, -solid_normal)
    with pytest.raises(ValidationError, match="a shell has no inside"):
        TriangleMesh(file=file, inside=True, thickness=0.3)


def test_a_mesh_container_is_shown_by_its_edges_or_all_of_it(tmp_path: Path) -> None:
    box = saved(tmp_path, trimesh.creation.box((1.0, 2.0, 1.5)), "tank.ply")
    ball = saved(tmp_path, trimesh.creation.icosphere(subdivisions=3), "bowl.ply")
    bodies = Bodies(
        {"tank": TriangleMesh(file=box, inside=True), "bowl": TriangleMesh(file=ball, inside=True)}
    )
    tank, bowl = bodies.snapshot()
    assert isinstance(tank, Lines)
    assert isinstance(bowl, Lines)
    # Twelve edges of a box, none of its diagonals; a smooth mesh has no creases: all of its edges.
    ends = tank.position[tank.segments].astype(np.float64)
    along = np.sort(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
    np.testing.assert_allclose(along, np.repeat([1.0, 1.5, 2.0], 4), atol=1e-6)
    assert len(bowl.segments) == 30 * 4**3


def test_five_thousand_triangles_are_quick(tmp_path: Path) -> None:
    file = saved(tmp_path, trimesh.creation.icosphere(subdivisions=4), "ball.ply")
    params = TriangleMesh(file=file, resolution=64)
    Bodies({"b": TriangleMesh(file=file, resolution=8)})  # compiles the kernels
    start = clock.process_time()
    Bodies({"b": params})
    assert clock.process_time() - start < BUILD_SECONDS
    assert len(read_mesh(file).triangles) == 5120


def test_several_meshes_share_the_samples(tmp_path: Path) -> None:
    box = saved(tmp_path, trimesh.creation.box((1.0, 1.0, 1.0)), "box.ply")
    ball = saved(tmp_path, trimesh.creation.icosphere(subdivisions=3), "ball.ply")
    bodies = Bodies(
        {
            "box": TriangleMesh(file=box, resolution=16, position=(-3.0, 0.0, 0.0)),
            "rock": Sphere(),
            "ball": TriangleMesh(file=ball, resolution=24, position=(3.0, 0.0, 0.0)),
        }
    )
    distance, _, _ = bodies.distance([[-2.0, 0.0, 0.0], [0.0, 1.5, 0.0], [3.0, 1.25, 0.0]])
    np.testing.assert_allclose(distance, [0.5, 0.5, 0.25], atol=0.01)
    box_part, _, ball_part = bodies.snapshot()
    assert isinstance(box_part, Mesh)
    np.testing.assert_allclose(np.abs(box_part.position - [-3.0, 0.0, 0.0]), 0.5, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(ball_part.position - [3.0, 0.0, 0.0], axis=1), 1.0, atol=1e-6)


BAD_FILES = {
    "text.obj": (b"hello", "holds no triangles"),
    "text.ply": (b"hello", "not a readable .ply mesh"),
    "text.stl": (b"hello", "triangles|readable"),
    "text.off": (b"hello", "not a readable .off mesh"),
    "empty.obj": (b"", "holds no triangles"),
    "empty.ply": (b"", "not a readable .ply mesh"),
    "zeros.stl": (bytes(200), "triangles|readable"),
    "noise.ply": (np.random.default_rng(0).bytes(300), "not a readable .ply mesh"),
    "points.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds no triangles"),
    "line.obj": (b"v 0 0 0\nv 1 0 0\nf 1 2 2\n", "all triangles are points or lines"),
    "nan.obj": (b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not finite"),
    "missing.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "point that is not there|readable"),
    "picture.png": (b"\x89PNG\r\n", r"not a mesh file; must be one of \.obj, \.ply, \.stl, \.off"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_file_that_is_no_mesh_gives_one_line(tmp_path: Path, name: str) -> None:
    content, message = BAD_FILES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SceneError, match=message) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)
    assert name in str(caught.value)
    with pytest.raises(ValidationError, match=message):
        TriangleMesh(file=path)


def test_a_missing_file_gives_one_line(tmp_path: Path) -> None:
    for name in ("none.obj", "a" * 5000 + ".obj"):
        with pytest.raises(ValidationError, match="no such file"):
            TriangleMesh(file=tmp_path / name)
    with pytest.raises(SceneError, match="cannot be read"):
        read_mesh(tmp_path / "none.obj")


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    file = saved(tmp_path, trimesh.creation.box((1.0, 1.0, 1.0)), "a.ply")
    assert read_mesh(file).extent == pytest.approx([1.0, 1.0, 1.0])
    saved(tmp_path, trimesh.creation.box((2.0, 1.0, 1.0)), "a.ply")
    assert read_mesh(file).extent == pytest.approx([2.0, 1.0, 1.0])


# A ball that grows from radius 1 by GROWTH a key, at FPS keys a second.
GROWTH, FPS, KEYS = 0.25, 4.0, 4


@pytest.fixture(scope="module")
def growing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("growing")
    for key in range(KEYS):
        mesh = trimesh.creation.icosphere(subdivisions=3)
        mesh.vertices *= 1.0 + GROWTH * key
        # Without leading zeros: 10 comes after 9, not after 1.
        saved(folder, mesh, f"ball_{key + 8}.ply")
    return folder


def sequence(folder: Path, **fields: object) -> MeshSequence:
    return MeshSequence.model_validate({"files": folder, "fps": FPS, "resolution": 32, **fields})


@pytest.mark.parametrize(
    ("repeat", "time", "radius", "speed"),
    [
        ("none", 0.0, 1.0, 1.0),
        ("none", 0.25, 1.25, 1.0),
        ("none", 0.3, 1.3, 1.0),
        ("none", 0.7, 1.7, 1.0),
        ("none", 9.0, 1.75, 0.0),
        ("loop", 0.8, 1.05, 1.0),
        ("pingpong", 0.8, 1.7, -1.0),
        ("pingpong", 1.6, 1.1, 1.0),
    ],
)
def test_a_sequence_blends_its_keys(
    growing: Path, repeat: str, time: float, radius: float, speed: float
) -> None:
    bodies = Bodies({"b": sequence(growing, repeat=repeat, **POSE)})
    bodies.move(time, 0.01)
    away = np.random.default_rng(1).normal(size=(200, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    distance, normal, velocity = bodies.distance(POSE["position"] + 1.2 * radius * away)
    cell = 2.0 * (1.0 + GROWTH * (KEYS - 1)) / 32
    # Facets of 1,280 triangles lie up to 0.005 r inside; trilinear 3 cell^2 / (8 r).
    np.testing.assert_allclose(distance, 0.2 * radius, atol=0.01 * radius + cell**2 / radius)
    np.testing.assert_allclose((velocity * normal).sum(axis=1), speed, atol=0.02)
    (part,) = bodies.snapshot()
    arm = part.position - POSE["position"]
    np.testing.assert_allclose(np.linalg.norm(arm, axis=1), radius, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(part.data["velocity"], float), speed * arm / radius, atol=1e-4)


def test_a_sequence_forwards_and_by_jumps_is_the_same(growing: Path) -> None:
    """Slots are filled as keys come by: what is in them must not depend on the way there."""
    x = np.random.default_rng(4).uniform(-2.5, 2.5, (300, 3))
    walked, jumped = Bodies({"b": sequence(growing)}), Bodies({"b": sequence(growing)})
    for time in (0.0, 0.2, 0.4, 0.6, 0.3):
        walked.move(time, 0.1)
    jumped.move(0.3, 0.1)
    for one, other in zip(walked.distance(x), jumped.distance(x), strict=True):
        np.testing.assert_array_equal(one, other)


def test_memory_of_a_sequence_does_not_grow_with_its_keys(growing: Path, tmp_path: Path) -> None:
    few = Bodies({"b": sequence(growing / "ball_*.ply")}).samples.shape[0]
    for key in range(2 * KEYS):
        (tmp_path / f"b_{key}.ply").write_bytes((growing / f"ball_{8 + key % KEYS}.ply").read_bytes())
    assert Bodies({"b": sequence(tmp_path)}).samples.shape[0] == few


def test_keys_whose_points_meet_keep_their_triangles(tmp_path: Path) -> None:
    """A key may close a gap: points that coincide there stay two points, as in the first key."""
    mesh: Any = trimesh.util.concatenate(
        [
            trimesh.creation.box((1.0, 1.0, 1.0)),
            trimesh.creation.box((1.0, 1.0, 1.0)).apply_translation((2.0, 0.0, 0.0)),
        ]
    )
    saved(tmp_path, mesh, "a_0.ply")
    mesh.vertices[8:, 0] -= 1.0
    saved(tmp_path, mesh, "a_1.ply")
    bodies = Bodies({"b": sequence(tmp_path)})
    bodies.move(1.0 / FPS, 0.01)
    (part,) = bodies.snapshot()
    assert len(part.position) == 16


def test_bad_sequences(growing: Path, tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="a sequence needs two or more meshes"):
        sequence(tmp_path)
    with pytest.raises(ValidationError, match="a sequence needs two or more meshes"):
        sequence(tmp_path / "none_*.obj")
    with pytest.raises(ValidationError, match=r"cannot be read|needs two or more"):
        sequence(tmp_path / ("a" * 5000))
    saved(tmp_path, trimesh.creation.box((1.0, 1.0, 1.0)), "a_0.ply")
    saved(tmp_path, trimesh.creation.icosphere(subdivisions=1), "a_1.ply")
    with pytest.raises(
        SceneError, match=r"a_1\.ply: 42 points and 80 triangles, not the same mesh as .*a_0\.ply"
    ):
        Bodies({"b": sequence(tmp_path)})


def test_bodies_are_told_apart_by_kind_and_found_beside_the_scene(growing: Path) -> None:
    adapter: TypeAdapter[BodyParams] = TypeAdapter(BodyParams)
    near = {"folder": growing.parent}
    box = adapter.validate_python({"kind": "box", "size": [1.0, 2.0, 3.0]})
    assert box == Box(size=(1.0, 2.0, 3.0))
    mesh = adapter.validate_python({"kind": "mesh", "file": "growing0/ball_8.ply"}, context=near)
    assert isinstance(mesh, TriangleMesh)
    frames = adapter.validate_python({"kind": "mesh_sequence", "files": "growing0/ball_*.ply"}, context=near)
    assert isinstance(frames, MeshSequence)
    with pytest.raises(ValidationError, match="must not be the zero vector"):
        adapter.validate_python({"kind": "plane", "normal": [0.0, 0.0, 0.0]})
