"""A small valid example of every kind of system, and digests of short runs, here or in another process.

python every_system.py THREADS          prints {"kind-example": digest, ...}
"""

import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tianim.spatial.bodies import Bodies
from tianim.system import Bounds, World
from tianim.systems import SYSTEMS

OPEN = Bounds()
STEPS = 12


@dataclass(frozen=True)
class Example:
    """Parameters as a scene file has them, and the bounds around.

    `count` is the field that says how many, or gives the fields for so many. `random` says whether the
    seed matters, `flows` whether particles come and go, `fewest` how many there are at least.
    """

    params: Mapping[str, Any]
    bounds: Bounds = OPEN
    count: str | Callable[[int], Mapping[str, Any]] = "count"
    note: str = "minimal"
    random: bool = True
    flows: bool = False
    fewest: int = 0

    def sized(self, count: int) -> Mapping[str, Any]:
        """The parameters that make it so many particles."""
        return {self.count: count} if isinstance(self.count, str) else self.count(count)


_BOX = {"kind": "box", "size": (8.0, 8.0, 8.0)}
_HUNTED: dict[str, Any] = {
    "count": 1500,
    "start": _BOX,
    "neighbourhood": {"kind": "topological", "k": 7},
    "separation": {"radius": 1.0, "field_of_view": 250.0},
    "behaviours": (
        {"kind": "wander", "weight": 2.0},
        {"kind": "evasion", "target": {"kind": "species", "name": "hunters"}},
        {"kind": "containment", "size": 5.0},
    ),
    "species": {
        "hunters": {
            "count": 3,
            "behaviours": ({"kind": "pursuit", "target": {"kind": "species", "name": "flock"}},),
        }
    },
}


def _cluster(count: int) -> dict[str, Any]:
    """A Plummer sphere of so many stars, or no component at all."""
    return {"components": {"stars": {"kind": "plummer", "count": count, "mass": 1.0}} if count else {}}


_SPACING = 0.05


def _pool(*layers: int) -> dict[str, Any]:
    """A block of so many layers of particles along each axis, thrown at a wall."""
    upper = tuple(_SPACING * (n + 0.5) for n in (*layers, 1)[:3])
    lower = (0.5 * _SPACING,) * 2 + ((0.5 * _SPACING if len(layers) == 3 else -_SPACING),)
    return {"pool": {"kind": "box", "lower": lower, "upper": upper, "velocity": (-2.0, -1.0, 0.0)}}


def _water(count: int) -> dict[str, Any]:
    """About so many particles, exactly where they are none or one."""
    side = max(round(count ** (1 / 3)), 1)
    return _waiting(count) | ({"blocks": _pool(side, side, count // side**2)} if count else {"blocks": {}})


def _flat_water(count: int) -> dict[str, Any]:
    """The same in the plane."""
    side = max(round(count ** (1 / 2)), 1)
    return _waiting(count) | ({"blocks": _pool(side, count // side)} if count else {"blocks": {}})


def _waiting(count: int) -> dict[str, Any]:
    """No emitter but, where there is nothing else, one that has not begun."""
    later = {"kind": "disc", "position": (1.0,) * 3, "speed": 1.0, "start": 100.0, "end": 100.1}
    return {"emitters": {} if count else {"later": later}, "sinks": {}}


_LID = {"kind": "box", "lower": (0.025, 0.475, 0.025), "upper": (0.525, 0.675, 0.525)}
_TANK = Bounds("contained", (0.0,) * 3, (10.0,) * 3)
_HOSE: dict[str, Any] = {
    "spacing": _SPACING,
    "blocks": _pool(10, 9, 10),
    "emitters": {
        "hose": {
            "kind": "disc", "position": (1.0, 2.0, 1.0), "direction": (-1.0, 0.0, 0.0), "radius": 0.2,
            "speed": 8.0, "end": 1.0, "jitter": 0.1,
        }
    },
    "sinks": {"drain": {"kind": "box", "lower": (0.4, 0.0, 0.0), "upper": (0.8, 0.3, 0.8)}},
    "wcsph": {"sound_speed": 10.0},  # so that its short steps see fluid come
}  # fmt: skip


def _masses(count: int) -> dict[str, Any]:
    """One mass that nothing holds, a sheet of about so many, or no piece at all."""
    side = max(round(count ** (1 / 2)) - 1, 1)
    piece: dict[str, Any] = {"kind": "sheet", "segments": (side, side), "bend": 1e-5}
    if count == 1:
        piece = {"kind": "network", "points": ((0.5, 0.5, 0.5),)}
    return {"pieces": {"piece": piece} if count else {}, "pins": {}, "stitches": {}, "pushes": {}}


def _ropes(count: int) -> dict[str, Any]:
    """A rope of so many points; two at least."""
    rope = {"kind": "rope", "points": ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))}
    hair = {"kind": "strands", "count": max(count // 32, 1), "segments": 31}
    piece: dict[str, Any] = {**rope, "segments": 1} if count == 2 else hair
    return {"pieces": {"piece": piece} if count > 1 else {}, "pins": {}}


_CORNERS_OF_A_CUBE = tuple((float(k % 2), float(k // 2 % 2), float(k // 4)) for k in range(8))
_BODIES: dict[str, Any] = {
    "cage": {
        "kind": "network",
        "points": (*_CORNERS_OF_A_CUBE, (0.5, 0.5, 2.0)),
        "mass": (1.0,) * 8 + (2.0,),
        "springs": tuple({"between": (k, 8), "stiffness": 50.0, "damping": 0.5} for k in range(8)),
        "spin": (0.0, 1.0, 0.0),
    },
    "rope": {"kind": "rope", "points": ((0.0, 2.0, 0.0), (1.0, 2.0, 0.0)), "segments": 10, "bend": 1e-4},
    "jelly": {"kind": "block", "position": (3.0, 0.0, 0.0), "spacing": 0.1, "velocity": (0.0, 1.0, 0.0)},
}
_FLAG: dict[str, Any] = {
    "pieces": {"flag": {"kind": "sheet", "segments": (24, 16), "bend": 1e-3, "skip": 5.0}},
    "pins": {"pole": {"piece": "flag", "points": "left"}},
    "pushes": {"pull": {"piece": "flag", "points": "right_top", "force": (0.1, 0.0, 0.0)}},
}
_FALLING: dict[str, Any] = {
    "pieces": {
        "cloth": {
            "kind": "sheet", "segments": (12, 12), "origin": (0.1, 0.05, 0.1), "velocity": (1.0, -3.0, 0.0)
        },
        "patch": {"kind": "sheet", "segments": (12, 4), "size": (1.0, 0.3), "origin": (0.1, 0.05, 1.1)},
    },
    "stitches": {
        "seam": {
            "first": {"piece": "cloth", "points": "top"}, "second": {"piece": "patch", "points": "bottom"}
        }
    },
}  # fmt: skip
_WIND = {"wind": (5.0, 0.0, 2.0), "gusts": 0.3}
_SOFT: dict[str, Any] = {"softening": {"length": 0.05}}
_TENTH = {"kind": "fixed", "length": 0.1}
EXAMPLES: dict[str, tuple[Example, ...]] = {
    "boids": (
        Example({"count": 1500, "start": _BOX}),
        Example(_HUNTED, note="hunted"),
        # More than one core sorts.
        Example({"count": 40_000, "start": {"kind": "box", "size": (24.0,) * 3}}, note="many"),
        Example(
            {"count": 1500, "start": _BOX, "dimension": 2},
            Bounds("periodic", (-4.0,) * 3, (4.0,) * 3),
            note="periodic, in two dimensions",
        ),
    ),
    "couzin": (Example({"count": 1500, "start": {"kind": "ball", "radius": 15.0}}),),
    "fluid": (
        Example({"spacing": _SPACING, "blocks": _pool(10, 9, 10)}, _TANK, _water, random=False),
        *(
            Example({**_HOSE, "method": method}, _TANK, _water, f"hose and drain, {method}", flows=True)
            for method in ("dfsph", "pbf", "wcsph")
        ),
        *(
            Example(
                {"method": method, "dimension": 2, "spacing": _SPACING, "blocks": _pool(40, 30)},
                Bounds("periodic", (0.0,) * 3, (16.0, 16.0, 1.0)),
                _flat_water,
                f"periodic, in two dimensions, {method}",
                random=False,
            )
            for method in ("dfsph", "pbf", "wcsph")
        ),
        # Solved for implicitly, drops that pull together, whirls kept going, walls that hold on.
        Example(
            {
                "spacing": _SPACING,
                "blocks": {**_pool(10, 9, 10), "lid": {**_LID, "phase": "oil"}},
                "viscosity": 0.5,
                "surface_tension": 0.5,
                "vorticity": 0.05,
                "walls": {"friction": 1.0},
                "phases": {"oil": {"density": 800.0, "viscosity": 1e-3}},
            },
            _TANK,
            _water,
            "viscous, two phases",
            random=False,
        ),
    ),
    "gravity": (
        Example({**_cluster(500), **_SOFT, "time_step": _TENTH}, count=_cluster),
        # Halves of steps are undone, a Runge-Kutta step and the external field have arrays of their own.
        Example(
            {
                **_cluster(300),
                "time_step": {"kind": "adaptive", "largest": 0.1, "levels": 4},
                **_SOFT,
                "integrator": "rk4",
                "external": ({"kind": "nfw", "mass": 10.0, "scale_radius": 3.0},),
            },
            count=_cluster,
            note="adaptive, in a halo",
        ),
        Example(
            {**_cluster(300), "time_step": {"kind": "block", "largest": 0.1, "levels": 4}, **_SOFT},
            count=_cluster,
            note="block steps",
        ),
        # Enough for the tree.
        Example(
            {**_cluster(3000), **_SOFT, "time_step": _TENTH, "solver": {"kind": "tree"}},
            count=_cluster,
            note="tree",
        ),
    ),
    "springs": (
        *(
            Example(
                {"pieces": _BODIES, "solver": "explicit", "explicit": {"integrator": integrator}},
                count=_masses,
                note=f"network, rope and block, {integrator}",
                random=False,
                fewest=1,
            )
            for integrator in ("symplectic_euler", "velocity_verlet", "rk4")
        ),
        Example(
            {**_FLAG, "air": _WIND, "solver": "projective", "projective": {"scheme": "implicit_euler"}},
            count=_masses,
            note="flag, implicit Euler",
            fewest=1,
        ),
        Example(
            {**_FLAG, "air": _WIND, "solver": "projective", "projective": {"scheme": "bdf2"}},
            count=_masses,
            note="flag, BDF2",
            fewest=1,
        ),
        # More than one core steps.
        Example(
            {"pieces": {"cloth": {"kind": "sheet", "segments": (70, 70)}}, "solver": "projective"},
            count=_masses,
            note="many",
            random=False,
            fewest=1,
        ),
        *(
            Example(
                {**_FALLING, "solver": solver},
                _TANK,
                _masses,
                f"sheets in a tank, {solver}",
                random=False,
                fewest=1,
            )
            for solver in ("explicit", "projective")
        ),
        Example(
            {
                "pieces": {"hair": {"kind": "strands", "count": 60, "segments": 10}},
                "solver": "strands",
                "pins": {"roots": {"piece": "hair", "points": "roots"}},
            },
            count=_ropes,
            note="strands",
            random=False,
            fewest=2,
        ),
    ),
    "vicsek": (Example({"count": 1500}, Bounds("periodic", (0.0,) * 3, (12.0, 12.0, 1.0))),),
}


def examples_of(kind: str) -> tuple[Example, ...]:
    """Its examples; says what to do for a kind that has none."""
    if kind not in EXAMPLES:
        raise KeyError(
            f"system kind {kind!r} has no example: add its smallest valid parameters to EXAMPLES "
            f"in {__file__}, and every test of this suite runs on it"
        )
    return EXAMPLES[kind]


def make(
    kind: str,
    example: Example,
    seed: int = 1,
    fields: frozenset[str] | None = None,
    more: Mapping[str, Any] | None = None,
) -> Any:
    """The system of an example at its start; `more` replaces parameters."""
    params = SYSTEMS[kind].params.model_validate({"kind": kind, **example.params, **(more or {})})
    world = World(example.bounds, Bodies({}), seed, fields)
    return SYSTEMS[kind].system("one", params, world)


def run(system: Any, steps: int = STEPS, first: int = 0) -> Any:
    """The system, so many steps on, each as long as it may be."""
    for step in range(first, first + steps):
        dt = system.max_step()
        system.step(step * dt, dt)
    return system


def digest(system: Any) -> str:
    """Hash of all its state, storage order included, and of what it shows."""
    total = hashlib.blake2b()
    for name, array in sorted(system.state().items()):
        total.update(name.encode() + np.ascontiguousarray(array).tobytes())
    for part in system.snapshot():
        total.update(part.position.tobytes())
        for name, values in sorted(part.data.items()):
            total.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return total.hexdigest()


def digests() -> dict[str, str]:
    """Of every example after STEPS steps."""
    return {
        f"{kind}-{k}": digest(run(make(kind, example)))
        for kind in SYSTEMS
        for k, example in enumerate(EXAMPLES.get(kind, ()))
    }


if __name__ == "__main__":
    from tianim import runtime

    runtime.start(threads=int(sys.argv[1]))
    print(json.dumps(digests()))  # noqa: T201  (its output is its result)
