"""Couzin's three phases: swarm, torus and parallel group, as the zone of orientation widens.

A run is the re-run's: N = 100, s = 3 m/s, tau = 0.1 s, 40 deg/s, sigma = 0.05 rad, 270 deg,
r_r = 1 m, dr_a = 14 m; 2,500 steps, of which the last fifth is averaged.
"""

from functools import lru_cache, partial

import numpy as np

from tianim.validate.build import built
from tianim.validate.case import Case, Comparison, Figure

SOURCE = "Couzin et al. 2002, J. theor. Biol. 218, 1; limits from an independent re-run with 3 seeds"
STEPS, LAST, EVERY = 2500, 500, 5
TAU = 0.1  # s
SEEDS = (1, 2, 3)

Limit = tuple[Comparison, float]
# Width of the zone of orientation [m]: what the group does, limits of polarisation and of milling.
PHASES: dict[float, tuple[str, Limit, Limit]] = {
    0.0: ("swarm", ("below", 0.35), ("below", 0.35)),
    2.0: ("torus", ("below", 0.35), ("above", 0.6)),
    4.0: ("parallel group", ("above", 0.95), ("below", 0.15)),
}
FIGURES = {
    measure: Figure(f"couzin_{measure}", "width of the zone of orientation [m]", f"{measure} of the group")
    for measure in ("polarisation", "milling")
}


@lru_cache(maxsize=16)
def group(width: float, seed: int) -> dict[str, float]:
    """Mean polarisation and milling over the last steps of a run."""
    system = built("couzin", seed=seed, orientation_width=width, time_step=TAU)
    samples = []
    for step in range(STEPS):
        system.step(step * TAU, TAU)
        if step >= STEPS - LAST and step % EVERY == 0:
            samples.append(system.diagnostics())
    return {key: float(np.mean([sample[key] for sample in samples])) for key in FIGURES}


def _measure(width: float, measure: str, seed: int) -> float:
    return group(width, seed)[measure]


CASES: tuple[Case, ...] = tuple(
    Case(
        system="couzin",
        name=f"{measure} of the {phase}, seed {seed}",
        run=partial(_measure, width, measure, seed),
        expected=limit,
        comparison=comparison,
        source=SOURCE,
        slow=seed > 1,
        figure=FIGURES[measure] if seed == 1 else None,
        x=width,
    )
    for seed in SEEDS
    for width, (phase, *limits) in PHASES.items()
    for measure, (comparison, limit) in zip(FIGURES, limits, strict=True)
)
