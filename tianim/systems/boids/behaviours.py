"""What a boid may want besides its flock: the steering behaviours of Reynolds 1999, as data.

Each behaviour gives a desired acceleration a [m/s2]; w is its weight, v the boid's velocity,
v_max its top speed, d = target - x:

    seek                a = w (v_max d/|d| - v)
    flee                a = w (v_max (-d/|d|) - v)              while |d| < radius
    pursuit, evasion    seek and flee of where the target will be after |d| / v_max, at most `horizon`
    arrival             a = w (v_max min(|d|/slowing_radius, 1) d/|d| - v)
    wander              a = w n(t), n a smooth random direction of unit length, new `rate` times a second
    cruise              a = w (speed - |v|) v/|v|
    path                seek of the point `ahead` further along the path than the nearest one, where
                        x + 0.5 s v is farther than `radius` from it
    flow                a = w (u(x) - v), u a velocity field
    leader              arrival at `distance` behind the nearest leader
    roost               a = w times: back over the place when beyond `radius` of it, and to its height
    containment         a = w (inward) times how deep the point `look_ahead` seconds ahead is in the margin
    obstacle_avoidance  the same, out of the margin around bodies

Evasion, flee, containment and obstacle_avoidance are urgent: they draw on the acceleration budget
before the flock's rules; the others take what is left, in the order of the list. Source:
C. Reynolds, Steering Behaviors For Autonomous Characters, GDC 1999; roost after H. Hildenbrandt,
C. Carere, C. Hemelrijk, Behavioral Ecology 21 (2010), DOI 10.1093/beheco/arq149.
"""

from typing import Annotated, Literal

from pydantic import Field

from tianim.params import Animated, Name, NonNegative, Number, Params, Positive, Vector3

Weight = Animated[NonNegative]


class Point(Params):
    """A place, which may be keyframed."""

    kind: Literal["point"] = "point"
    position: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="where [m]")


class BodyTarget(Params):
    """The origin of a body of the scene."""

    kind: Literal["body"] = "body"
    name: Name = Field(description="name of the body")


class SpeciesTarget(Params):
    """The nearest boid of a species of this system."""

    kind: Literal["species"] = "species"
    name: Name = Field("flock", description="name of the species; `flock` is the main one")


Target = Annotated[Point | BodyTarget | SpeciesTarget, Field(discriminator="kind")]


class Steering(Params):
    """What all behaviours have."""

    weight: Weight = Field(1.0, description="strength w [1/s], or [m/s2] where the law gives a unit vector")


class Seek(Steering):
    """Towards the target at top speed."""

    kind: Literal["seek"] = "seek"
    target: Target = Field(Point(), description="whom")


class Flee(Steering):
    """Away from the target at top speed while it is near."""

    kind: Literal["flee"] = "flee"
    target: Target = Field(Point(), description="from whom")
    radius: Animated[Positive] = Field(10.0, description="minds nothing farther than this [m]")


class Pursuit(Steering):
    """Seek of where the target will be."""

    kind: Literal["pursuit"] = "pursuit"
    target: Target = Field(SpeciesTarget(), description="whom")
    horizon: NonNegative = Field(2.0, description="looks ahead at most this long [s]")


class Evasion(Steering):
    """Flee from where the target will be."""

    kind: Literal["evasion"] = "evasion"
    target: Target = Field(SpeciesTarget(), description="from whom")
    radius: Animated[Positive] = Field(10.0, description="minds nothing farther than this [m]")
    horizon: NonNegative = Field(1.0, description="looks ahead at most this long [s]")


class Arrival(Steering):
    """To the target, slower as it comes near."""

    kind: Literal["arrival"] = "arrival"
    target: Target = Field(Point(), description="where")
    slowing_radius: Animated[Positive] = Field(5.0, description="slows down within this [m]")


class Wander(Steering):
    """Smooth random steering, each boid its own."""

    kind: Literal["wander"] = "wander"
    rate: Positive = Field(1.0, description="new directions a second [1/s]")


class Cruise(Steering):
    """Back to a preferred speed."""

    kind: Literal["cruise"] = "cruise"
    speed: Animated[NonNegative] = Field(1.0, description="preferred speed [m/s]")


class PathFollowing(Steering):
    """Along a chain of points."""

    kind: Literal["path"] = "path"
    points: tuple[Vector3, ...] = Field(min_length=2, max_length=1000, description="corners of the path [m]")
    radius: NonNegative = Field(1.0, description="steers only when farther than this from the path [m]")
    ahead: Positive = Field(5.0, description="aims at the point this much further along [m]")
    loop: bool = Field(False, description="whether the last point leads to the first")


class Uniform(Params):
    """The same velocity everywhere: wind, current."""

    kind: Literal["uniform"] = "uniform"
    velocity: Animated[Vector3] = Field((1.0, 0.0, 0.0), description="velocity [m/s]")


class Vortex(Params):
    """Round an axis, at full speed at `radius`: u = speed (r/R) exp((1 - r^2/R^2)/2)."""

    kind: Literal["vortex"] = "vortex"
    centre: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="a point of the axis [m]")
    axis: Vector3 = Field((0.0, 1.0, 0.0), description="direction of the axis, any length but zero")
    radius: Positive = Field(10.0, description="radius of full speed R [m]")
    speed: Animated[Number] = Field(1.0, description="full speed [m/s], negative the other way round")


class Cellular(Params):
    """Rolls of alternating sense: u = speed (sin kx cos ky, -cos kx sin ky, 0), k = pi/size."""

    kind: Literal["cellular"] = "cellular"
    size: Positive = Field(10.0, description="width of a roll [m]")
    speed: Animated[Number] = Field(1.0, description="full speed [m/s]")


Flow = Annotated[Uniform | Vortex | Cellular, Field(discriminator="kind")]


class FlowFollowing(Steering):
    """With a velocity field."""

    kind: Literal["flow"] = "flow"
    field: Flow = Field(Uniform(), description="the field")


class LeaderFollowing(Steering):
    """Behind the nearest boid of the leaders' species."""

    kind: Literal["leader"] = "leader"
    leaders: Name = Field(description="name of the leaders' species")
    distance: NonNegative = Field(2.0, description="how far behind [m]")
    slowing_radius: Positive = Field(5.0, description="slows down within this [m]")


class Roost(Steering):
    """Stays over a place and near its height, as starlings do at dusk."""

    kind: Literal["roost"] = "roost"
    centre: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="the place and the height [m]")
    radius: Animated[Positive] = Field(50.0, description="free to fly within this, measured level [m]")
    vertical: Animated[NonNegative] = Field(0.1, description="pull to the height [1/s2], times the weight")


class Containment(Steering):
    """Turns back before the walls of the scene's bounds, or of a ball or box of its own."""

    kind: Literal["containment"] = "containment"
    centre: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="centre of the region [m]")
    size: Positive | tuple[Positive, Positive, Positive] | None = Field(
        None, description="radius of a ball or lengths of a box [m]; none: the scene's bounds"
    )
    margin: Positive = Field(2.0, description="starts to turn this far from the wall [m]")
    look_ahead: NonNegative = Field(0.5, description="looks this far ahead [s]")


class ObstacleAvoidance(Steering):
    """Round the bodies of the scene."""

    kind: Literal["obstacle_avoidance"] = "obstacle_avoidance"
    margin: Animated[Positive] = Field(1.0, description="keeps this far from surfaces [m]")
    look_ahead: Animated[NonNegative] = Field(1.0, description="looks this far ahead [s]")


URGENT = (ObstacleAvoidance, Containment, Evasion, Flee)

Behaviour = Annotated[
    Seek | Flee | Pursuit | Evasion | Arrival | Wander | Cruise | PathFollowing | FlowFollowing
    | LeaderFollowing | Roost | Containment | ObstacleAvoidance,
    Field(discriminator="kind"),
]  # fmt: skip
