"""The cases of `tianim bench`: what there is to measure, and at which sizes.

A measurement is a class built as `Measurement(task)` in a process of its own; its `round()`
repeats what is measured and gives a Round for each variant.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Protocol

from tianim.bench.lines import Round
from tianim.errors import SceneError
from tianim.scene.fields import nearest

SCENE_SUFFIXES = (".yaml", ".yml", ".toml", ".json")
# Of the double dam break: larger sizes take hours for a second and are measured over a tenth of it.
LARGEST_WHOLE, WHOLE, PART = 200_000, 1.0, 0.1  # [s]
# A periodic box must be three radii wide: with 20 neighbours in a radius it then holds so many.
SMALLEST_FLOCK = {2: 100, 3: 200}


def fluid_span(n: int) -> float:
    """Simulated time [s] over which the double dam break of about n particles is measured."""
    return WHOLE if n <= LARGEST_WHOLE else PART


@dataclass(frozen=True)
class Task:
    """One measurement to be made: `threads` None means every core."""

    case: str
    n: int
    dim: int
    threads: int | None = None


class Measurement(Protocol):
    """What a worker process holds."""

    n: int
    dim: int

    def round(self) -> Mapping[str, Round]:
        """Measure once more, from the same start: a Round for each variant."""

    def bytes_per_item(self) -> float | None:
        """Bytes of the arrays that one item takes, None where that says nothing."""


@dataclass(frozen=True)
class Case:
    """A case: `home` names its measurement, `module:class`.

    smallest  least n by dimension, for which the case makes sense
    compared  whether the variants are compared with the first of them
    sized     whether it takes sizes; a scene has its own
    rounds    how often it is measured, in turns with the peers; None: as usual
    """

    name: str
    description: str
    home: str
    sizes: tuple[int, ...]
    dims: tuple[int, ...] = (3,)
    smallest: Mapping[int, int] = field(default_factory=dict)
    compared: bool = False
    sized: bool = True
    rounds: int | None = None

    def tasks(self, sizes: list[int] | None, threads: int | None) -> list[Task]:
        """What to measure, smallest first. SceneError where a size is too small."""
        if sizes and not self.sized:
            raise SceneError(f"--n: the scene {self.name} has its own counts")
        chosen = sizes or list(self.sizes)
        for n in chosen:
            for dim in self.dims:
                least = self.smallest.get(dim, 1)
                if n < least:
                    raise SceneError(f"--n {n}: {self.name} needs at least {least} items in {dim}D")
        return [Task(self.name, n, dim, threads) for n in chosen for dim in self.dims]

    def measurement(self, task: Task) -> Measurement:
        """Build the measurement; this loads the compiler."""
        module, name = self.home.split(":")
        made: Measurement = getattr(import_module(f"tianim.bench.{module}"), name)(task)
        return made


_ALL = (
    Case(
        "boids",
        "a flock of 20 neighbours within the radius, whole steps in a periodic box",
        "flocks:Flock",
        (10_000, 100_000, 1_000_000),
        (2, 3),
        SMALLEST_FLOCK,
    ),
    Case(
        "boids_topological",
        "the same flock minding the 7 nearest",
        "flocks:TopologicalFlock",
        (10_000, 100_000),
        (2, 3),
        SMALLEST_FLOCK,
    ),
    Case(
        "grid",
        "the sort from any order, the sort as they move, and the walk over the neighbours",
        "flocks:Grid",
        (10_000, 100_000, 1_000_000),
        (2, 3),
        SMALLEST_FLOCK,
    ),
    Case(
        "gravity",
        "the forces between the stars of a sphere and of a galaxy, tree build included, and their error",
        "gravity:Forces",
        (10_000, 100_000, 1_000_000),
        smallest={3: 2},
    ),
    Case(
        "fluid",
        "a double dam break over a second: wall time of a simulated second, and density errors",
        "fluid:DoubleDam",
        (30_000, 100_000, 500_000),
        smallest={3: 200},
        rounds=1,
    ),
    Case(
        "springs",
        "a sheet that hangs, swings, falls onto a sphere: time of a frame, sag, strain and penetration",
        "springs:Cloth",
        (4_096, 16_384, 65_536),
        smallest={3: 16},
        rounds=1,
    ),
    Case(
        "export",
        "steps alone, and with frames written: a frame a step, a frame every 8 steps",
        "frames:Export",
        (1_000_000,),
        smallest=SMALLEST_FLOCK,
        compared=True,
    ),
    Case(
        "render",
        "a picture of 1280 x 720, as darts and as spheres",
        "frames:Render",
        (1_000_000,),
        smallest=SMALLEST_FLOCK,
    ),
    Case(
        "startup",
        "from the command to the first frame written, and to the first step written",
        "startup:Startup",
        (1_000,),
    ),
)
CASES: dict[str, Case] = {case.name: case for case in _ALL}


def find_case(name: str) -> Case:
    """The case called `name`, or a scene file as a case; SceneError names the nearest."""
    if name in CASES:
        return CASES[name]
    if name.lower().endswith(SCENE_SUFFIXES):
        return Case(name, "the steps of a scene", "scenes:SceneSteps", (0,), (0,), {0: 0}, sized=False)
    like = nearest(name, CASES)
    hint = f"did you mean {like!r}? " if like else ""
    raise SceneError(f"bench: no case {name!r}; {hint}there are {', '.join(CASES)}, and any scene file")
