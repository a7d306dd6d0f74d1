"""Surface tension of a fluid: its sums against float64, conservation, drops, cubes and sheets."""

import math
from typing import Any

import numpy as np
import pytest
from fluid_bed import CANCELS, SINGLE, SUPPORT, Bed, Floats, gathered, lattice, stirred
from scipy.spatial import ConvexHull, cKDTree

from tianim.math.smoothing import spline_scale, spline_slopes
from tianim.scene import build, scene_from
from tianim.systems.fluid import surface_tension
from tianim.systems.fluid.surface_tension import SurfaceTension, kernel_scale


def tension_by_hand(bed: Bed, sigma: float) -> Floats:
    """Accelerations by the equations of the module, in float64; no walls."""
    dimension, h = bed.particles.dimension, SUPPORT[bed.particles.dimension]
    i, j, d, r = bed.pair_list()
    strength = sigma * surface_tension.CALIBRATION[dimension]
    slope = bed.particles.volume * spline_scale(h, dimension) * spline_slopes(r / h, dimension) / h
    g = gathered(i, (slope / r)[:, None] * d, bed.n)
    size = np.linalg.norm(g, axis=1)
    t = np.clip(size / surface_tension.INSIDE - 1.0, 0.0, 1.0)
    layer = 2.0 * strength * t * t * (3.0 - 2.0 * t) * size
    n = g / np.maximum(size, 1e-20)[:, None]
    stress = layer[:, None, None] * (
        (1.0 + surface_tension.COHESION[dimension]) * np.eye(3) - n[:, :, None] * n[:, None, :]
    )
    near = np.maximum(1.0 - (r / h) ** 2, 0.0)
    pull = -4.0 * kernel_scale(h, dimension) * near / h**2
    force = pull[:, None] * np.einsum("kab,kb->ka", stress[i] + stress[j], d)
    soft = 1.0 / (r**2 + surface_tension.SOFTENING**2)
    core = (
        surface_tension.CORE_FORCE * strength * np.maximum(1.0 - (r / surface_tension.CORE) ** 2, 0.0) * soft
    )
    v = bed.stored("velocity")
    lightest = min(liquid.density for liquid in bed.phases)
    friction = surface_tension.FRICTION * math.sqrt(lightest / strength) * (layer[i] + layer[j])
    rub = friction * near * soft * np.einsum("kc,kc->k", v[i] - v[j], d)
    return gathered(i, force + (core - rub)[:, None] * d, bed.n) / bed.mass()[:, None]


@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize("dimension", [2, 3])
def test_surface_tension_is_its_stress(dimension: int, two: bool) -> None:
    bed = stirred(dimension, two)
    SurfaceTension(0.7, bed.particles, bed.pairs, bed.walls).add(bed.pull)
    expected = tension_by_hand(bed, 0.7)
    # Five times: T has |grad c|, which cancels inside, where a little more or less than INSIDE decides.
    assert np.abs(bed.acceleration() - expected).max() < 5.0 * SINGLE * np.abs(expected).max()


@pytest.mark.parametrize("dimension", [2, 3])
def test_surface_tension_keeps_momentum(dimension: int) -> None:
    """Across phases of density 1 and 5 too."""
    bed = stirred(dimension, two=True)
    SurfaceTension(1.0, bed.particles, bed.pairs, bed.walls).add(bed.pull)
    force = bed.mass()[:, None] * bed.acceleration()
    assert np.abs(force.sum(axis=0)).max() < CANCELS * np.abs(force).sum()


def test_a_wall_is_wetted_at_a_right_angle() -> None:
    """A lattice that stands on a wall has no tension there: the wall makes up for what is missing."""
    x = lattice(12, 3)
    bed = Bed(x, np.zeros_like(x), 3)
    y = bed.stored("position")[:, 1]
    row = (np.abs(x[:, 1] - 0.5) < 0.1) & (np.abs(x[:, [0, 2]] - 6.0) < 3.0).all(axis=1)
    assert row.any()
    axis = np.arange(-2.0, 3.0)
    around = np.stack(np.meshgrid(*[axis] * 3, indexing="ij"), -1).reshape(-1, 3)
    below = around[(around[:, 1] < 0.0) & (np.linalg.norm(around, axis=1) < SUPPORT[3])]
    r = np.linalg.norm(below, axis=1)
    missing = (
        bed.particles.volume * spline_scale(SUPPORT[3], 3) * spline_slopes(r / SUPPORT[3], 3) / SUPPORT[3]
    )
    toward = float((missing / r * -below[:, 1]).sum())  # the fluid that the wall takes the place of
    for count in (0, 1):
        bed.walls.count = count
        bed.walls.put("share", np.where(y < 1.0, 0.15, 0.0))
        bed.walls.put("gradient", np.stack([0.0 * y, np.where(y < 1.0, toward, 0.0), 0.0 * y]))
        tension = SurfaceTension(1.0, bed.particles, bed.pairs, bed.walls)
        tension.add(bed.pull)
        order = np.argsort(bed.particles["id"].to_numpy()[0, : bed.n])
        strength = (tension.layer.to_numpy()[:, : bed.n] ** 2).sum(axis=0)[order][row]
        assert (strength > 0.3).all() if count == 0 else (strength == 0.0).all()


def liquid(dimension: int, blocks: Any, **more: Any) -> Any:
    """A fluid in open space without gravity, spacing and density 1, surface tension 1."""
    water = {"kind": "fluid", "dimension": dimension, "spacing": 1.0, "density": 1.0, "viscosity": 0.0}
    water |= {
        "surface_tension": 1.0,
        "gravity": [0.0, 0.0, 0.0],
        "blocks": blocks,
        "time_step": {"largest": 1.0},
    }
    scene = {"tianim": 1, "title": "drop", "fps": 1, "duration": 1, "systems": {"water": water | more}}
    return build(scene_from(scene)).systems["water"]


def scatter(fluid: Any, by: float) -> None:
    """Move each particle by up to `by` along each axis: a lattice is a solid, a liquid is not."""
    x = fluid.read("position")
    fluid.write("position", x + np.random.default_rng(5).uniform(-by, by, x.shape))


def settle(fluid: Any, seconds: float, rate: float) -> float:
    """Let it run while its velocities are damped at `rate` [1/s]; the step [s] that was used."""
    dt = float(fluid.max_step())
    for k in range(int(seconds / dt)):
        fluid.step(k * dt, dt)
        fluid.write("velocity", fluid.read("velocity") * np.float32(math.exp(-rate * dt)))
    return dt


def stretched(x: Floats, dimension: int) -> float:
    """How much longer than thick, from second moments."""
    s = ((x - x.mean(axis=0)) ** 2).mean(axis=0)
    return float((s[0] - s[1:dimension].mean()) / s[:dimension].mean())


def test_a_drop_swings_in_rayleighs_period() -> None:
    """A disc, R = 12 d: omega^2 = 6 sigma / (rho R^3), half a period to 7 %.

    It starts round and moving; half a period later it is round again.
    """
    fluid = liquid(2, {"disc": {"kind": "sphere", "centre": [0.0, 0.0, 0.0], "radius": 12.0}})
    scatter(fluid, 0.2)
    settle(fluid, 12.0, 0.3)
    radius = math.sqrt(fluid.count / math.pi)
    omega = math.sqrt(6.0 / radius**3)
    x = fluid.read("position").astype(np.float64)
    x -= x.mean(axis=0)
    fluid.write("velocity", 0.12 * omega * np.stack([x[:, 0], -x[:, 1], 0.0 * x[:, 0]], axis=1))
    dt = float(fluid.max_step())
    shapes = []
    for k in range(int(1.2 * math.pi / omega / dt)):
        fluid.step(k * dt, dt)
        shapes.append(stretched(fluid.read("position").astype(np.float64), 2))
    signs = np.sign(shapes)
    half = dt * (1 + np.nonzero((signs[:-1] > 0) & (signs[1:] < 0))[0][0])
    assert half == pytest.approx(math.pi / omega, rel=0.07)


def test_a_cube_becomes_a_sphere_under_laplaces_pressure() -> None:
    """Sphericity of the hull, which is 0.806 for a cube; momentum stays; little motion is left.

    The pressure inside is 2 sigma / R to 25 %, at ten particles across and a mean over 12 s.
    """
    fluid = liquid(3, {"cube": {"kind": "box", "lower": [0.0, 0.0, 0.0], "upper": [8.0, 8.0, 8.0]}})
    place = fluid.read("position").astype(np.float64).mean(axis=0)
    dt = settle(fluid, 25.0, 0.05)
    x = fluid.read("position").astype(np.float64)
    hull = ConvexHull(x)
    assert math.pi ** (1.0 / 3.0) * (6.0 * hull.volume) ** (2.0 / 3.0) / hull.area > 0.95
    v = fluid.read("velocity").astype(np.float64)
    # Less than a tenth of the energy that the surface sets free, 75 sigma d^2, which would be 0.54.
    assert np.sqrt((v**2).sum(axis=1).mean()) < 0.15
    assert np.abs(v.sum(axis=0)).max() < 1e-5 * len(v)
    # The drift of places, which undoes compression, keeps no momentum book.
    assert np.abs(x.mean(axis=0) - place).max() < 5e-3
    radius = (0.75 * len(x) / math.pi) ** (1.0 / 3.0)
    pressures = []
    for k in range(int(12.0 / dt)):
        fluid.step(k * dt, dt)
        x = fluid.read("position").astype(np.float64)
        inside = np.linalg.norm(x - x.mean(axis=0), axis=1) < 0.6 * radius
        pressures.append(fluid.read("pressure")[inside].mean())
    assert np.mean(pressures) == pytest.approx(2.0 / radius, rel=0.25)


def test_a_sheet_of_one_layer_holds_together() -> None:
    """No holes and no beads: the edge draws in, the middle stays a layer of single particles."""
    fluid = liquid(3, {"sheet": {"kind": "box", "lower": [0.0, 0.0, 0.0], "upper": [16.0, 16.0, 1.0]}})
    assert fluid.count == 256
    dt = float(fluid.max_step())
    for k in range(int(4.0 / dt)):
        fluid.step(k * dt, dt)
    x = fluid.read("position").astype(np.float64)
    near = cKDTree(x).query(x, 2)[0][:, 1]
    assert near.max() < 1.5
    assert np.median(near) > 0.75
