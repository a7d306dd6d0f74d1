"""The scene as data: what a scene file may hold.

A scene lasts `duration` seconds and has round(fps x duration) + 1 frames: frame 0 is the start
at time 0, so a duration of 0 gives one picture of the start.
"""

from functools import lru_cache
from typing import Annotated, Any, Literal, Union

from pydantic import Field, create_model, model_validator
from typing_extensions import Self

from tianim.export.options import OutputOptions
from tianim.params import Name, Params, Vector3
from tianim.spatial.body_params import BodyParams
from tianim.system import Bounds, SystemParams
from tianim.systems import SYSTEMS
from tianim.view.look import Look

# A film of nine hours at 30 frames a second; a typing error in fps or duration is far beyond.
MOST_FRAMES = 1_000_000
LONGEST = 1e9  # s
MOST_NAMES = 1000  # systems or bodies of a scene


class OpenBounds(Params):
    """Space without an end."""

    kind: Literal["open"] = "open"

    def value(self) -> Bounds:
        """What systems see."""
        return Bounds()


class _Cornered(Params):
    """A box between two corners."""

    lower: Vector3 = Field(
        description="corner with the smallest coordinates [m]", examples=[[-5.0, -5.0, -5.0]]
    )
    upper: Vector3 = Field(description="corner with the largest coordinates [m]", examples=[[5.0, 5.0, 5.0]])

    @model_validator(mode="after")
    def _lower_is_below_upper(self) -> Self:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise ValueError(
                    f"lower must be less than upper in every axis; in {axis}, {low:g} is not below {high:g}"
                )
        return self


class PeriodicBounds(_Cornered):
    """A box whose opposite faces are one: what leaves on one side comes in on the other."""

    kind: Literal["periodic"] = "periodic"

    def value(self) -> Bounds:
        """What systems see."""
        return Bounds(self.kind, self.lower, self.upper)


class ContainedBounds(_Cornered):
    """A box with walls."""

    kind: Literal["contained"] = "contained"

    def value(self) -> Bounds:
        """What systems see."""
        return Bounds(self.kind, self.lower, self.upper)


class Checkpoint(Params):
    """When the state is saved, so that a stopped run can go on."""

    every: int = Field(30, ge=1, le=MOST_FRAMES, description="frames between two checkpoints")


class Scene(Params):
    """A scene: what is simulated, for how long, where, and what is made of it.

    `scene_model()` is this with the kinds of systems that there are; `load_scene` and
    `scene_from` make instances of it.
    """

    tianim: Literal[1] = Field(description="version of the scene format", examples=[1])
    title: str = Field("", max_length=200, description="name for people")
    description: str = Field("", max_length=2000, description="one line for `tianim list`")
    fps: float = Field(30.0, gt=0, le=1000, description="frames a second [1/s]")
    duration: float = Field(10.0, ge=0, le=LONGEST, description="length [s]; 0 gives the start alone")
    seed: int = Field(1, ge=0, lt=2**32, description="start of all random numbers")
    bounds: Annotated[OpenBounds | PeriodicBounds | ContainedBounds, Field(discriminator="kind")] = Field(
        OpenBounds(), description="the domain"
    )
    bodies: dict[Name, BodyParams] = Field(
        {}, max_length=MOST_NAMES, description="shapes that systems see: colliders, targets, predators"
    )
    systems: dict[Name, SystemParams] = Field(
        min_length=1, max_length=MOST_NAMES, description="what is simulated, by name"
    )
    output: OutputOptions = Field(OutputOptions(), description="files that a run writes")
    view: Look = Field(Look(), description="pictures and film")
    checkpoint: Checkpoint = Field(Checkpoint(), description="saved states")

    @property
    def frame_count(self) -> int:
        """Frames of the scene, the start included."""
        return round(self.fps * self.duration) + 1


def scene_model() -> type[Scene]:
    """The model of a scene with the kinds of the SYSTEMS table as it is now."""
    return _scene_model(tuple(kind.params for kind in SYSTEMS.values()))


@lru_cache(maxsize=8)
def _scene_model(kinds: tuple[type[SystemParams], ...]) -> type[Scene]:
    choice: Any = kinds[0]
    if len(kinds) > 1:
        choice = Annotated[Union[kinds], Field(discriminator="kind")]  # noqa: UP007  (made at run time)
    base = Scene.model_fields["systems"]
    systems = Field(min_length=1, max_length=MOST_NAMES, description=base.description)
    return create_model("Scene", __base__=Scene, __doc__=Scene.__doc__, systems=(dict[Name, choice], systems))
