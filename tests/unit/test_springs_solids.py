"""Solids of tetrahedra: their forces, their small strains, what leaves rigid motion alone."""

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem
from tianim.systems.springs.solids import energies

# Kernels compute forces in float32.
SINGLE = 2e-6
E, NU = 2.0e4, 0.3


def solid(solver: str = "explicit", pins: dict[str, Any] | None = None, **more: Any) -> SpringSystem:
    """A block of 0.2 x 0.1 x 0.1 m without gravity."""
    piece = {
        "kind": "solid", "size": (0.2, 0.1, 0.1), "spacing": 0.05, "stiffness": E, "poisson": NU, **more,
    }  # fmt: skip
    params = SpringsParams.model_validate(
        {
            "kind": "springs",
            "solver": solver,
            "gravity": (0.0, 0.0, 0.0),
            "pieces": {"block": piece},
            "pins": pins or {},
        }
    )
    return SpringSystem("one", params, World(Bounds(), Bodies({}), 1))


def forces(one: SpringSystem, x: Any, v: Any = None) -> Any:
    """What the kernels give, from the velocities of a tiny step."""
    before = np.zeros_like(x) if v is None else v
    one.write("position", x)
    one.write("velocity", before)
    dt = 1e-9
    one.step(0.0, dt)
    return (one.read("velocity") - before) / dt * one.read("mass")[:, None]


def test_mass_and_volume() -> None:
    one = solid(density=500.0)
    assert one.read("mass").sum() == pytest.approx(500.0 * 0.002)
    assert one.whole.elements is not None
    assert one.whole.elements.volume.sum() == pytest.approx(0.002)
    assert (one.whole.elements.volume > 0.0).all()


def test_forces_are_minus_the_slope_of_the_energy() -> None:
    one, rng = solid(damping=0.0), np.random.default_rng(2)
    x = one.read("position") + 0.01 * rng.normal(size=(one.count, 3))
    got = forces(one, x)
    for i, c in ((0, 0), (11, 1), (20, 2), (44, 0)):
        ahead, behind = x.copy(), x.copy()
        ahead[i, c] += 1e-6
        behind[i, c] -= 1e-6
        slope = (
            energies(ahead, one.whole.elements).sum() - energies(behind, one.whole.elements).sum()
        ) / 2e-6
        assert got[i, c] == pytest.approx(-slope, abs=10.0 * SINGLE * np.abs(got).max())


@pytest.mark.parametrize("turned", [False, True])
def test_at_rest_nothing_pushes(turned: bool) -> None:
    one = solid()
    x = one.read("position")
    if turned:
        x = Rotation.from_rotvec([0.3, -1.1, 0.7]).apply(x) + np.array([1.0, 2.0, 3.0])
    # A strain of float32's rounding on a face of a cell.
    assert np.abs(forces(one, x)).max() < SINGLE * E * 0.05**2


def test_small_strains_are_those_of_linear_elasticity() -> None:
    """Energy density lambda/2 tr(e)^2 + mu e:e of any small uniform strain."""
    one, rng = solid(), np.random.default_rng(7)
    mu, lame = E / (2.0 * (1.0 + NU)), E * NU / ((1.0 + NU) * (1.0 - 2.0 * NU))
    x = one.read("position")
    for _ in range(5):
        strain = 1e-5 * rng.normal(size=(3, 3))
        strain = 0.5 * (strain + strain.T)
        density = 0.5 * lame * np.trace(strain) ** 2 + mu * (strain**2).sum()
        found = energies(x @ (np.eye(3) + strain), one.whole.elements).sum() / 0.002
        assert found == pytest.approx(density, rel=1e-3)


def test_dampers_leave_rigid_motion_alone() -> None:
    one = solid(damping=0.02)
    x = Rotation.from_rotvec([0.2, 0.4, -0.1]).apply(one.read("position"))
    v = np.cross([3.0, -2.0, 5.0], x) + np.array([1.0, 0.0, 2.0])
    still = forces(one, x)
    moving = forces(one, x, v)
    viscous = E * 0.02 * 5.0 * 0.05**2  # of a rate of 5 / s on a face of a cell
    assert np.abs(moving - still).max() < 1e-5 * viscous


def test_dampers_take_energy() -> None:
    one, rng = solid(damping=0.02), np.random.default_rng(4)
    x, v = one.read("position"), rng.normal(size=(one.count, 3))
    power = ((forces(one, x, v) - forces(one, x)) * v).sum()
    assert power < 0.0


@pytest.mark.slow
def test_what_is_turned_inside_out_comes_back() -> None:
    one = solid(damping=0.01, density=100.0)
    rest = one.read("position")
    x = rest.copy()
    x[:, 0] *= -0.4
    one.write("position", x)
    dt = one.max_step()
    for step in range(round(1.5 / dt)):
        one.step(step * dt, dt)
    F = np.linalg.lstsq(
        rest - rest.mean(axis=0), one.read("position") - one.read("position").mean(axis=0), rcond=None
    )[0]
    assert one.diagnostics()["elastic_energy"] < 1e-3 * energies(x, one.whole.elements).sum()
    assert np.linalg.det(F) == pytest.approx(1.0, abs=0.02)


def test_solids_need_explicit_steps() -> None:
    with pytest.raises(ValidationError, match="solids need explicit steps, not projective"):
        solid("projective")
    assert solid("auto").solver.name == "explicit"


def test_what_cannot_be_pressed_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"poisson"):
        solid(poisson=0.5)


def test_the_strain_that_is_shown() -> None:
    """Stretched by a tenth along x and pressed by a fifth across, everywhere alike."""
    one = solid()
    one.write("position", one.read("position") * (1.1, 0.8, 1.0))
    shown: Any = one.snapshot()[0]
    np.testing.assert_allclose(shown.data["strain"], 0.2, atol=1e-6)
    assert one.diagnostics()["strain_max"] == pytest.approx(0.2)
