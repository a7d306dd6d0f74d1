"""What pieces are made into: stiffness by energies, bending by curvature, rows, the factor, bad input."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from numpy.typing import NDArray
from pydantic import ValidationError

from tianim.errors import SceneError
from tianim.lang import f32_2d, i32_1d, ti
from tianim.systems.springs.assembly import BENDING, STIFFNESS, Assembly, assemble, implicit_matrix
from tianim.systems.springs.explicit import longest_step
from tianim.systems.springs.factor import backward_row, dissection, factorise, forward_row
from tianim.systems.springs.params import SpringsParams
from tianim.validate.build import built

Floats = NDArray[np.float64]

# Energies are quadratic in the strain; what is of third order is as small as the strain itself.
STRAIN = 1e-5
THIRD_ORDER = 20 * STRAIN


def assembled(*pieces: dict[str, Any], **fields: Any) -> Assembly:
    """Pieces named a, b, c ..."""
    return assemble(parameters(*pieces, **fields))


def parameters(*pieces: dict[str, Any], **fields: Any) -> SpringsParams:
    named = {chr(97 + k): piece for k, piece in enumerate(pieces)}
    return SpringsParams.model_validate({"kind": "springs", "pieces": named, **fields})


def energy(whole: Assembly, x: Floats) -> float:
    """Of all springs, by hand [J]."""
    a, b = whole.springs.ends.T
    stretch = np.linalg.norm(x[b] - x[a], axis=1) - whole.springs.rest_length
    return float(0.5 * (whole.springs.stiffness * stretch**2).sum())


def relaxed_stiffness(whole: Assembly, axis: int, free: tuple[int, ...], volume: float) -> float:
    """Second derivative of the energy over the volume by the strain along `axis`, least over the others.

    Strains are homogeneous; `free` are the axes that may narrow.
    """
    x = whole.position

    def at(strain: Floats) -> float:
        return energy(whole, x * (1.0 + strain)) / volume

    axes = (axis, *free)
    n = len(axes)
    hessian = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            total = 0.0
            for si, sj in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                strain = np.zeros(3)
                strain[axes[i]] += si * STRAIN
                strain[axes[j]] += sj * STRAIN
                total += si * sj * at(strain)
            hessian[i, j] = total / (4.0 * STRAIN**2)
    return float(1.0 / np.linalg.inv(hessian)[0, 0])


@pytest.mark.parametrize("segments", [(6, 6), (10, 6), (6, 8)])
@pytest.mark.parametrize("diagonals", [0, 1, 2])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_sheet_has_the_stiffness_that_is_given(
    segments: tuple[int, int], diagonals: int, axis: int
) -> None:
    sheet = {"kind": "sheet", "segments": segments, "stretch": 700.0, "shear": 150.0, "diagonals": diagonals}
    whole = assembled(sheet)
    if diagonals == 1 and segments[0] != segments[1]:
        return  # one diagonal couples stretch and shear
    measured = relaxed_stiffness(whole, axis, (2 - axis,), 1.0)
    assert measured == pytest.approx(700.0, rel=THIRD_ORDER)


@pytest.mark.parametrize(("diagonals", "modulus"), [(0, 0.0), (1, 150.0), (2, 150.0)])
def test_a_sheet_resists_shear_by_its_diagonals(diagonals: int, modulus: float) -> None:
    whole = assembled({"kind": "sheet", "segments": (5, 5), "shear": 150.0, "diagonals": diagonals})
    energies = []
    for angle in (STRAIN, -STRAIN):
        x = whole.position.copy()
        x[:, 0] += angle * x[:, 2]
        energies.append(2.0 * energy(whole, x) / angle**2)
    assert np.mean(energies) == pytest.approx(modulus, rel=THIRD_ORDER, abs=1e-3)


@pytest.mark.parametrize("spacing", [0.1, 0.06])
def test_a_block_has_young_s_modulus(spacing: float) -> None:
    whole = assembled({"kind": "block", "spacing": spacing, "stiffness": 5e3})
    # Springs of faces belong to one cell: homogeneous strain has the energy of the bulk all over.
    for axis in range(3):
        free = tuple(a for a in range(3) if a != axis)
        assert relaxed_stiffness(whole, axis, free, 0.3**3) == pytest.approx(5e3, rel=THIRD_ORDER)
    assert whole.mass.sum() == pytest.approx(27.0)


def triangle_lattice(rows: int, columns: int, h: float) -> tuple[Floats, NDArray[np.int64]]:
    """Equilateral triangles in the plane y = 0; a rhombus."""
    i, j = np.meshgrid(np.arange(columns + 1), np.arange(rows + 1))
    x = np.stack([h * (i + 0.5 * j), 0.0 * i, 0.5 * np.sqrt(3.0) * h * j], axis=-1).reshape(-1, 3)
    corner = (i + (columns + 1) * j)[:-1, :-1].ravel()
    right, up = corner + 1, corner + columns + 1
    triangles = np.concatenate([np.stack([corner, right, up], 1), np.stack([right, up + 1, up], 1)])
    return x, triangles


def mesh_file(folder: Path, x: Floats, triangles: Any) -> dict[str, Any]:
    """A piece of kind mesh."""
    path = folder / "mesh.obj"
    text = [f"v {a!r} {b!r} {c!r}\n" for a, b, c in x.tolist()]
    text += [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in np.asarray(triangles).tolist()]
    path.write_text("".join(text))
    return {"kind": "mesh", "file": path}


@pytest.mark.parametrize("axis", [0, 2])
def test_a_mesh_has_the_stiffness_that_is_given(tmp_path: Path, axis: int) -> None:
    """With all edges counted by the area at them; Poisson's ratio is 1/3, so the free side narrows."""
    x, triangles = triangle_lattice(8, 8, 0.1)
    whole = assembled({**mesh_file(tmp_path, x, triangles), "stretch": 700.0})
    area = len(triangles) * 0.25 * np.sqrt(3.0) * 0.01
    assert relaxed_stiffness(whole, axis, (2 - axis,), area) == pytest.approx(700.0, rel=THIRD_ORDER)
    assert whole.mass.sum() == pytest.approx(0.2 * area)


def rolled(x: Floats, axis: int, radius: float) -> Floats:
    """Onto a cylinder, without stretching (but for chords)."""
    bent = x.copy()
    bent[:, axis] = radius * np.sin(x[:, axis] / radius)
    bent[:, 1] = radius * (1.0 - np.cos(x[:, axis] / radius))
    return bent


@pytest.mark.parametrize("axis", [0, 2])
def test_a_rolled_sheet_has_the_energy_of_its_curvature(axis: int) -> None:
    """B / 2 k^2 where a point has neighbours on both sides: half a cell at each end has none."""
    cells, radius, bend = (24, 16), 2.0, 0.03
    whole = assembled({"kind": "sheet", "segments": cells, "bend": bend})
    x = rolled(whole.position, axis, radius)
    n = cells[0] if axis == 0 else cells[1]
    measured = 0.5 * float(np.einsum("ij,ij->", x, whole.bending @ x))
    # Chords for arcs: (h / R)^2 / 12.
    assert measured == pytest.approx(0.5 * bend / radius**2 * (n - 1) / n, rel=1e-3)


def test_a_twisted_sheet_has_the_energy_of_its_twist() -> None:
    """Raised by c u v: B / 2 of 2 (x_uv)^2, exact, for the difference over a cell is the derivative."""
    bend, twist = 0.03, 0.1
    whole = assembled({"kind": "sheet", "segments": (7, 9), "bend": bend})
    x = whole.position.copy()
    x[:, 1] = twist * x[:, 0] * x[:, 2]
    assert 0.5 * np.einsum("ij,ij->", x, whole.bending @ x) == pytest.approx(bend * twist**2)


@pytest.mark.parametrize("angle", [0.0, 25.0, 90.0])
def test_a_rolled_mesh_has_the_energy_of_its_curvature(tmp_path: Path, angle: float) -> None:
    """A large lattice of equilateral triangles; hinges at its border are missing, one row of many."""
    x, triangles = triangle_lattice(60, 60, 0.02)
    a, radius, bend = np.radians(angle), 2.0, 0.03
    whole = assembled({**mesh_file(tmp_path, x, triangles), "bend": bend})
    start = whole.position
    along = start[:, 0] * np.cos(a) + start[:, 2] * np.sin(a)
    bent = start.copy()
    shift = radius * np.sin(along / radius) - along
    bent[:, 0] += shift * np.cos(a)
    bent[:, 2] += shift * np.sin(a)
    bent[:, 1] = radius * (1.0 - np.cos(along / radius))
    area = len(triangles) * 0.25 * np.sqrt(3.0) * 0.02**2
    measured = 0.5 * float(np.einsum("ij,ij->", bent, whole.bending @ bent))
    assert measured == pytest.approx(0.5 * bend / radius**2 * area, rel=0.03)


def test_a_bent_rope_has_the_energy_of_its_curvature() -> None:
    n, radius, bend = 40, 1.5, 0.02
    rope = {"kind": "rope", "points": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], "segments": n, "bend": bend}
    whole = assembled(rope)
    x = rolled(whole.position, 0, radius)
    measured = 0.5 * float(np.einsum("ij,ij->", x, whole.bending @ x))
    assert measured == pytest.approx(0.5 * bend / radius**2 * (n - 1) / n, rel=1e-3)


def scene() -> dict[str, Any]:
    """A sheet that bends, sewn to another, a rope and a block."""
    sheet = {"kind": "sheet", "segments": (9, 7), "bend": 1e-3, "skip": 3.0}
    rope = {"kind": "rope", "points": [(3.0, 0.0, 0.0), (4.0, 1.0, 0.0)], "segments": 9, "bend": 1e-3}
    pieces = {"a": sheet, "b": {**sheet, "origin": (0.0, 0.0, 1.0)}, "c": rope, "d": {"kind": "block"}}
    seam = {"first": {"piece": "a", "points": "top"}, "second": {"piece": "b", "points": "bottom"}}
    return {"pieces": pieces, "stitches": {"seam": seam}}


def lively() -> Assembly:
    return assemble(SpringsParams.model_validate({"kind": "springs", **scene()}))


def test_rows_hold_both_ends_of_every_spring_alike() -> None:
    system = built("springs", **scene())
    whole, points = system.whole, system.points
    start, neighbour, row = (array.to_numpy() for array in (points.start, points.neighbour, points.row))
    of = np.repeat(np.arange(whole.count), np.diff(start))
    for column in range(row.shape[1]):
        A = scipy.sparse.coo_matrix((row[:, column], (of, neighbour)), shape=(whole.count,) * 2).tocsr()
        assert abs(A - A.T).max() == 0.0
    assert row[:, STIFFNESS].sum() == pytest.approx(2.0 * whole.springs.stiffness.sum(), rel=1e-6)
    bending = scipy.sparse.coo_matrix((row[:, BENDING], (of, neighbour)), shape=(whole.count,) * 2).tocsr()
    off = whole.bending - scipy.sparse.diags(whole.bending.diagonal())
    # Coefficients are float32.
    assert abs(bending + off).max() < 1e-6 * abs(off).max()


def test_bending_pushes_nothing_as_a_whole() -> None:
    """Rows of Q sum to zero, and so do its moments: no force, no torque."""
    whole = lively()
    scale = abs(whole.bending).max()
    assert np.abs(whole.bending @ np.ones(whole.count)).max() < 1e-12 * scale
    x = whole.position + np.random.default_rng(1).normal(0.0, 0.1, whole.position.shape)
    force = -whole.bending @ x
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-10 * scale


def hessian(whole: Assembly, x: Floats) -> Floats:
    """Of the energy of springs and bending, (3 n, 3 n)."""
    n = whole.count
    H = np.zeros((n, 3, n, 3))
    springs = whole.springs
    for (a, b), k, rest in zip(springs.ends, springs.stiffness, springs.rest_length, strict=True):
        d = x[b] - x[a]
        length = np.linalg.norm(d)
        u = d / length if length else np.zeros(3)
        block = k * (np.outer(u, u) + (1.0 - rest / length if length else 1.0) * (np.eye(3) - np.outer(u, u)))
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            H[i, :, j, :] += sign * block
    if whole.bending is not None:
        H += np.einsum("ij,kl->ikjl", whole.bending.toarray(), np.eye(3))
    return H.reshape(3 * n, 3 * n)


@pytest.mark.parametrize("bend", [0.0, 1e-5, 1e-3, 1.0])
def test_the_implicit_matrix_is_above_the_hessian(bend: float) -> None:
    """Steps of the quasi-Newton method never go too far: weak bending is bounded, strong stands as it is."""
    whole = assembled({"kind": "sheet", "segments": (5, 4), "bend": bend})
    x = whole.position + np.random.default_rng(2).normal(0.0, 0.02, whole.position.shape)
    A = implicit_matrix(whole, np.zeros(whole.count, np.bool_), 0.01).toarray() - np.diag(
        whole.mass / 0.01**2
    )
    above = np.kron(A, np.eye(3)) - hessian(whole, x)
    lowest = float(np.linalg.eigvalsh(above).min())
    assert lowest > -1e-9 * abs(A).max()


def test_the_longest_step_is_below_the_limit_of_the_lattice() -> None:
    """And not by much: 2 / omega of the exact highest mode, at rest."""
    whole = assembled({"kind": "sheet", "segments": (6, 6), "bend": 1e-3, "damping": 0.0})
    H = hessian(whole, whole.position)
    root = np.repeat(1.0 / np.sqrt(whole.mass), 3)
    omega = np.sqrt(np.linalg.eigvalsh(root[:, None] * H * root).max())
    assert 0.5 < longest_step(whole) * omega / 2.0 <= 1.0 + 1e-12


@ti.kernel
def _forward(n: ti.i32, start: i32_1d, row: i32_1d, value: ti.types.ndarray(ti.f32, 1), y: f32_2d):
    ti.loop_config(serialize=True)
    for i in range(n):
        forward_row(start, row, value, y, i)


@ti.kernel
def _backward(
    n: ti.i32, start: i32_1d, column: i32_1d, value: ti.types.ndarray(ti.f32, 1),
    inverse: ti.types.ndarray(ti.f32, 1), y: f32_2d,
):  # fmt: skip
    ti.loop_config(serialize=True)
    for back in range(n):
        backward_row(start, column, value, inverse, y, n - 1 - back)


def test_the_factor_solves_as_a_library_does() -> None:
    whole = lively()
    held = np.zeros(whole.count, np.bool_)
    held[:5] = True
    A = implicit_matrix(whole, held, 1.0 / 120.0)
    factor = factorise(A, whole.position)
    b = np.random.default_rng(3).normal(size=(whole.count, 3))
    y = ti.ndarray(ti.f32, (whole.count, 3))
    place = factor.place.to_numpy()[: whole.count]
    given = np.zeros((whole.count, 3), np.float32)
    given[place] = b
    y.from_numpy(given)
    _forward(whole.count, factor.row_start, factor.row, factor.row_value, y)
    _backward(
        whole.count, factor.column_start, factor.column, factor.column_value, factor.inverse, y
    )  # fmt: skip
    exact = scipy.sparse.linalg.spsolve(A, b)
    # Float32 along rows of the factor.
    np.testing.assert_allclose(y.to_numpy()[place], exact, atol=1e-5 * np.abs(exact).max())


def test_branches_and_top_are_all_places_once() -> None:
    whole = lively()
    factor = factorise(implicit_matrix(whole, np.zeros(whole.count, np.bool_), 0.01), whole.position)
    done = [np.arange(a, b) for a, b in factor.ranges.to_numpy()[: factor.range_start.to_numpy()[-1]]]
    done.append(factor.tops.to_numpy()[: factor.top_count])
    np.testing.assert_array_equal(np.sort(np.concatenate(done)), np.arange(whole.count))
    order = dissection(whole.position, abs(implicit_matrix(whole, np.zeros(whole.count, bool), 0.01)).tocsr())
    np.testing.assert_array_equal(np.sort(order), np.arange(whole.count))


def test_a_matrix_that_is_not_positive_is_refused() -> None:
    A = scipy.sparse.csc_matrix(np.array([[1.0, 2.0], [2.0, 1.0]]))
    with pytest.raises(SceneError, match="not positive definite"):
        factorise(A, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))


def test_the_report_is_the_sum_over_springs() -> None:
    system = built("springs", **scene())
    whole, report = system.whole, system.report
    x = whole.position + np.random.default_rng(4).normal(0.0, 0.01, whole.position.shape)
    bending = 0.5 * np.einsum("ij,ij->", x, whole.bending @ x)
    assert report.elastic(x) == pytest.approx(energy(whole, x) + bending)
    found = report.measure(x, np.zeros_like(x), 0.0)
    assert found["potential_energy"] == pytest.approx(9.81 * whole.mass @ x[:, 1])


SHEET: dict[str, Any] = {"kind": "sheet", "segments": (4, 4)}
NETWORK: dict[str, Any] = {"kind": "network", "points": [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]}


@pytest.mark.parametrize(
    ("pieces", "fields", "message"),
    [
        ([{**SHEET, "v": (1.0, 1.0, 0.0)}], {}, "u and v must be at right angles; their cosine is 0.707"),
        ([{"kind": "rope", "points": [(0.0,) * 3] * 2}], {}, "points 0 and the next are in one place"),
        ([{**NETWORK, "mass": (1.0,) * 3}], {}, "mass: 3 values for 2 points"),
        ([{**NETWORK, "springs": [{"between": (0, 2)}]}], {}, "no point 2; there are 0 to 1"),
        ([{**NETWORK, "springs": [{"between": (1, 1)}]}], {}, "joins point 1 to itself"),
        (
            [{**NETWORK, "points": [(0.0,) * 3] * 2, "springs": [{"between": (0, 1)}]}], {},
            "points 0 and 1 are in one place, so it has no direction",
        ),
        ([SHEET], {"pins": {"p": {"piece": "b", "points": "left"}}}, "no piece 'b' in pieces; there are a"),
        ([SHEET], {"pins": {"p": {"piece": "a", "points": [25]}}}, "no point 25; a has 0 to 24"),
        ([SHEET], {"pins": {"p": {"piece": "a"}}}, "give either points or a box"),
        ([SHEET], {"pins": {"p": {"piece": "a", "lower": (0.0,) * 3}}}, "give either points or a box"),
        (
            [SHEET], {"pins": {"p": {"piece": "a", "points": "left", "start": 2.0, "end": 1.0}}},
            "end 1 s: must be after start, 2 s",
        ),
    ],
)  # fmt: skip
def test_bad_input_is_refused(pieces: list[dict[str, Any]], fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        parameters(*pieces, **fields)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"pins": {"p": {"piece": "a", "points": "front"}}}, "pins.p.points: a has no 'front'; it has left"),
        (
            {"pins": {"p": {"piece": "a", "lower": (5.0,) * 3, "upper": (6.0,) * 3}}},
            "pins.p: no point of a starts in the box",
        ),
        (
            {"pins": {"p": {"piece": "a", "points": "left"}, "q": {"piece": "a", "points": "left_top"}}},
            r"pins.q: holds point 4, and so does pins.p at the same time \(1 points in both\)",
        ),
        (
            {"stitches": {"s": {"first": {"piece": "a", "points": "left"},
                                "second": {"piece": "a", "points": "left_top"}}}},
            "stitches.s: joins 5 points to 1; there must be as many",
        ),
        (
            {"stitches": {"s": {"first": {"piece": "a", "points": [1]},
                                "second": {"piece": "a", "points": [1]}}}},
            "stitches.s: joins a point to itself",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_pieces_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        built("springs", pieces={"a": SHEET}, **fields)


def test_pins_that_take_turns_may_share_points() -> None:
    pins = {
        "p": {"piece": "a", "points": "left", "end": 1.0},
        "q": {"piece": "a", "points": "left_top", "start": 1.0},
    }
    built("springs", pieces={"a": SHEET}, pins=pins)


def test_oblong_cells_that_diagonals_would_make_unstable_are_refused() -> None:
    with pytest.raises(
        SceneError, match=r"pieces.a: cells of 0.25 x 0.01 m are too oblong for shear 100 N/m"
    ):
        assembled({**SHEET, "segments": (4, 100), "shear": 100.0, "stretch": 200.0})


def test_a_mesh_with_an_edge_of_three_triangles_is_refused(tmp_path: Path) -> None:
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    with pytest.raises(ValidationError, match="3 triangles share the edge between points"):
        parameters(mesh_file(tmp_path, x, [(0, 1, 2), (0, 1, 3), (0, 1, 4)]))


def test_a_mesh_with_a_triangle_without_area_is_refused(tmp_path: Path) -> None:
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(ValidationError, match="has no area"):
        parameters(mesh_file(tmp_path, x, [(0, 1, 2), (0, 1, 3)]))
