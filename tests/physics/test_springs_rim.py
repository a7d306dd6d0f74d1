"""A cloth over the rim of a table: contact gives it no energy, whatever its normals do there."""

import numpy as np
import pytest

from tianim.spatial.bodies import Bodies, Box
from tianim.system import Bounds, World
from tianim.systems.springs import SpringsParams, SpringSystem

ACROSS = 48
FRAMES = 40
# What is put back at a wall is lifted by a part of its thickness: of the whole cloth at most this [J].
LIFTED = 0.02


@pytest.mark.parametrize("scheme", ["implicit_euler", "bdf2"])
def test_a_cloth_on_a_table_gains_no_energy(scheme: str) -> None:
    sheet = {
        "kind": "sheet", "size": (1.5, 1.5), "segments": (ACROSS, ACROSS), "origin": (-0.75, 0.83, -0.75),
        "stretch": 800.0, "shear": 60.0, "bend": 2e-4, "damping": 3e-3,
    }  # fmt: skip
    params = SpringsParams.model_validate(
        {
            "kind": "springs", "pieces": {"cloth": sheet}, "solver": "projective",
            "projective": {"scheme": scheme}, "contact": {"thickness": 0.008, "friction": 0.4},
        }
    )  # fmt: skip
    bodies = Bodies({"top": Box(size=(0.9, 0.06, 0.9), position=(0.0, 0.75, 0.0))})
    system = SpringSystem("cloth", params, World(Bounds(), bodies, 1))
    dt, energy = 1.0 / 120.0, []
    for step in range(4 * FRAMES):
        bodies.move(step * dt, dt)
        system.step(step * dt, dt)
        energy.append(system.diagnostics()["total_energy"])
    assert np.max(np.diff(energy)) < LIFTED
    assert energy[-1] < energy[0]
    assert system.diagnostics()["strain_max"] < 0.3
