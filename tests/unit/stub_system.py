"""A system of one number, for tests of the scene that must not depend on what systems there are."""

from collections.abc import Collection
from typing import Any, Literal

from pydantic import Field

from tianim.params import Animated, Count, NonNegative, Params, Positive
from tianim.system import Bounds, SystemParams, World

BYTES_PER_ITEM = 1000
STEP = 0.01  # s
SECONDS_PER_STEP = 2.0


class Rule(Params):
    radius: Positive = Field(1.0, description="reach [m]")
    weight: Animated[NonNegative] = Field(1.0, description="strength")


class Push(Params):
    kind: Literal["push"] = "push"
    strength: NonNegative = Field(1.0, description="force [N]")


class Pull(Params):
    kind: Literal["pull"] = "pull"
    strength: NonNegative = Field(1.0, description="force [N]")
    body: str = Field("", description="name of a body")


class StubParams(SystemParams):
    """Parameters with one field of each sort."""

    kind: Literal["stub"] = "stub"
    count: Count = Field(10, description="how many")
    rule: Rule = Field(Rule(radius=2.0, weight=3.0), description="a rule with defaults of its own")
    wishes: tuple[Push | Pull, ...] = Field((Push(strength=5.0), Pull()), description="what it wants")
    size: Positive | tuple[Positive, Positive] | Literal["auto"] = Field("auto", description="size [m]")
    helper: Rule | None = Field(None, description="another rule")

    def particle_count(self) -> int:
        return self.count

    def memory_bytes(self) -> int:
        return BYTES_PER_ITEM * self.count

    def seconds_per_step(self) -> float:
        return SECONDS_PER_STEP

    def largest_step(self) -> float:
        return STEP

    def check_scene(
        self, scene_bounds: Bounds, body_names: Collection[str], system_names: Collection[str]
    ) -> None:
        for wish in self.wishes:
            if isinstance(wish, Pull) and wish.body and wish.body not in body_names:
                raise ValueError(f"no body {wish.body!r}")


class Stub:
    """Keeps what it was built with."""

    def __init__(self, name: str, params: StubParams, world: World) -> None:
        self.name, self.params, self.world = name, params, world

    def max_step(self) -> float:
        return STEP

    def step(self, time: float, dt: float) -> None:
        pass

    def snapshot(self) -> tuple[Any, ...]:
        return ()

    def diagnostics(self) -> dict[str, float]:
        return {}

    def check(self) -> None:
        pass
