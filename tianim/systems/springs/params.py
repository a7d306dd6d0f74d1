"""Parameters of springs: pieces, what holds and pushes them, air, contact, solver.

Everything is in SI. Stiffnesses are those of a material (`piece_params.py`), so that the same scene at
another resolution behaves the same.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from tianim.errors import SceneError
from tianim.params import Animated, Fraction, Name, NonNegative, Params, Positive, Vector3
from tianim.system import Bounds, SystemParams
from tianim.systems.springs.first_step import longest_first_step
from tianim.systems.springs.piece_params import Index, Network, PieceParams, Rope, Solid, Strands

MOST_NAMES = 1000
MOST_POINTS = 1 << 24
# Longest step of the implicit solver [s]: two in a frame of 60 a second.
LONGEST_IMPLICIT = 1.0 / 120.0
# Longest step of the solver xpbd [s]: twenty in a frame of 60 a second.
LONGEST_XPBD = 1.0 / 1200.0
# Where explicit steps may be as long as this [s], they cost less than the implicit solver.
EXPLICIT_FROM = 1e-3
# Bytes of a point, of a spring (both ways), of the factor of a point, and of its contact with other surfaces.
BYTES_PER_POINT, BYTES_PER_SPRING, BYTES_OF_FACTOR, BYTES_OF_CONTACT = 260, 180, 700, 300
SECONDS_PER_STEP = {"explicit": 1.5e-4, "projective": 5e-4, "strands": 3e-4, "xpbd": 4e-4}
SECONDS_PER_POINT = {"explicit": 6e-8, "projective": 2e-6, "strands": 5e-7, "xpbd": 2.5e-7}
SECONDS_OF_CONTACT = 5e-7

Integrator = Literal[
    "symplectic_euler", "velocity_verlet", "rk4", "forward_euler", "trapezoid", "constant_acceleration"
]


class Pick(Params):
    """Some points of a piece: by a name, by their numbers, or all that start in a box."""

    piece: Name = Field(description="piece that they belong to", examples=["cloth"])
    points: Annotated[str, Field(max_length=32)] | tuple[Index, ...] | None = Field(
        None,
        description="left, right, bottom, top and corners as left_top (sheets), left to front (blocks), "
        "border (meshes), first, last, ends (ropes), roots, tips (strands), all; or numbers of points",
        examples=["left_top"],
    )
    lower: Vector3 | None = Field(None, description="corner of a box instead [m]")
    upper: Vector3 | None = Field(None, description="its opposite corner [m]")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        box = self.lower is not None and self.upper is not None
        if (self.lower is None) != (self.upper is None) or box == (self.points is not None):
            raise ValueError("give either points or a box, lower and upper")
        return self


class Pin(Pick):
    """Points that are held: where they start, along a path, or on a body."""

    body: Name | None = Field(None, description="body that they move with; left out: they stay")
    offset: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="moves them from there [m]")
    start: NonNegative = Field(0.0, description="held from then on [s]: where they are at that time")
    end: Positive | None = Field(None, description="let go at that time [s]")

    def holds(self, time: float) -> bool:
        """Whether it holds at `time` [s]."""
        return self.start <= time and (self.end is None or time < self.end)

    @model_validator(mode="after")
    def _ends_after_start(self) -> Self:
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"end {self.end:g} s: must be after start, {self.start:g} s")
        return self


class Push(Pick):
    """A force on points, as long as the channel says."""

    force: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="on each of the points [N]")


class Stitch(Params):
    """Points of two pieces joined one to one, by springs of no length."""

    first: Pick = Field(
        description="points of one piece", examples=[{"piece": "cloth", "points": "right_bottom"}]
    )
    second: Pick = Field(
        description="as many points of another, in the same order",
        examples=[{"piece": "cloth", "points": "left_bottom"}],
    )
    stiffness: Positive = Field(1e4, description="of each joint [N/m]")
    damping: NonNegative = Field(0.0, description="of each joint [N s/m]")


class Air(Params):
    """What the air does to sheets, triangle by triangle, and to all points.

    A triangle of area A that meets the air at speed u is pushed by rho / 2 A (C_n |u_n| u_n + C_t |u| u_t).
    """

    density: NonNegative = Field(1.2, description="of the air [kg/m3]")
    normal: NonNegative = Field(1.2, description="drag coefficient C_n across a sheet")
    tangential: NonNegative = Field(0.02, description="drag coefficient C_t along it")
    wind: Animated[Vector3] = Field((0.0, 0.0, 0.0), description="velocity of the air [m/s]")
    gusts: Fraction = Field(
        0.0, description="part of the wind's speed that whirls add: smooth noise that drifts with the wind"
    )
    gust_size: Positive = Field(0.5, description="size of the whirls [m]")
    drag: NonNegative = Field(0.0, description="slows every point, of sheets or not: a = -drag v [1/s]")


class BodyContact(Params):
    """How one body touches."""

    friction: NonNegative = Field(0.3, description="Coulomb's coefficient")


class Contact(Params):
    """How bodies and bounds are touched."""

    thickness: Positive = Field(0.002, description="distance that is kept from bodies [m]")
    friction: NonNegative = Field(0.3, description="Coulomb's coefficient")
    restitution: Fraction = Field(0.0, description="part of the speed given back; explicit only")
    self_collision: bool = Field(
        False,
        description="whether surfaces, or ropes and strands by the solver strands, touch each other and "
        "themselves; else they pass through",
    )
    self_thickness: Positive | None = Field(
        None,
        description="distance that surfaces keep from each other, or how thick ropes and strands are [m]; "
        "left out: `thickness`",
    )
    bodies: Mapping[Name, BodyContact] = Field(
        {}, max_length=MOST_NAMES, description="bodies with a friction of their own, by name"
    )


class Explicit(Params):
    """Of the solver `explicit`."""

    integrator: Integrator = Field(
        "symplectic_euler",
        description="symplectic_euler and velocity_verlet keep the energy of springs; the lectures' "
        "forward_euler, trapezoid and constant_acceleration do not; rk4 loses a little",
    )
    safety: Annotated[float, Field(gt=0, le=2)] = Field(
        0.7, description="step as a part of the longest stable one"
    )


class Projective(Params):
    """Of the solver `projective`."""

    scheme: Literal["implicit_euler", "bdf2"] | None = Field(
        None,
        description="bdf2 keeps the snap of motion, implicit_euler calms it; left out: bdf2, and "
        "implicit_euler where there is something to touch",
    )
    iterations: Annotated[int, Field(ge=1, le=200)] | None = Field(
        None,
        description="of the global solve in a step; left out: 3, and 5 where there is something to touch or "
        "to tear; three times as many where pieces touch each other in many places",
    )


class StrandsSolver(Params):
    """Of the solver `strands`."""

    iterations: Annotated[int, Field(ge=1, le=50)] = Field(2, description="of Newton's method in a step")


class Xpbd(Params):
    """Of the solver `xpbd`."""

    iterations: Annotated[int, Field(ge=1, le=100)] = Field(
        1, description="passes over all constraints in a step; shorter steps hold better than more passes"
    )


class Measured(Params):
    """What a frame's metrics hold beside energies, momenta, strains and contacts."""

    self_intersections: bool = Field(
        False,
        description="edges of surfaces that cut triangles, counted by brute force: seconds a frame from "
        "10,000 points on",
    )


class TimeStep(Params):
    """How long a step may be."""

    largest: Positive | None = Field(
        None,
        description="largest step [s]; left out: as long as is stable, and 1/120 s where that is for ever, "
        "1/1200 s by xpbd",
    )
    most_substeps: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        5000, description="steps that a frame may need; more stop the run and say why"
    )

    def asked(self, solver: str) -> float:
        """Largest step [s] that is asked for, whatever is stable."""
        return self.largest or (LONGEST_XPBD if solver == "xpbd" else LONGEST_IMPLICIT)


def refuse_substeps(substeps: int, allowed: TimeStep, step: float, solver: str) -> None:
    """ValueError where a frame needs more substeps than are `allowed`, of `step` [s] by `solver`."""
    if substeps > allowed.most_substeps:
        raise ValueError(
            f"a frame would need {substeps:,} substeps, of {step:.3g} s (the {solver} solver), more than "
            f"time_step.most_substeps, {allowed.most_substeps:,}: softer springs, heavier or fewer points, "
            "solver: projective, or a larger most_substeps"
        )


class SpringsParams(SystemParams):
    """Masses and springs: cloth, ropes, jelly, and what lectures draw."""

    kind: Literal["springs"] = "springs"
    pieces: Mapping[Name, PieceParams] = Field(
        min_length=1, max_length=MOST_NAMES, description="what there is, by name",
        examples=[{"cloth": {"kind": "sheet"}}],
    )  # fmt: skip
    pins: Mapping[Name, Pin] = Field({}, max_length=MOST_NAMES, description="points that are held, by name")
    stitches: Mapping[Name, Stitch] = Field({}, max_length=MOST_NAMES, description="seams, by name")
    pushes: Mapping[Name, Push] = Field({}, max_length=MOST_NAMES, description="forces on points, by name")
    gravity: Animated[Vector3] = Field((0.0, -9.81, 0.0), description="acceleration of all points [m/s2]")
    air: Air = Field(Air(), description="wind and drag")
    contact: Contact = Field(Contact(), description="how bodies are touched")
    solver: Literal["auto", "explicit", "projective", "strands", "xpbd"] = Field(
        "auto",
        description="explicit: many short steps; projective: few long ones with a factor computed once; "
        "strands: each rope or hair solved directly; xpbd: many small steps that go through all constraints "
        "in turn, for contact and tears; auto: strands where all pieces are, else explicit where "
        "its steps may be a millisecond long, else projective",
    )
    explicit: Explicit = Field(Explicit(), description="of the solver explicit")
    projective: Projective = Field(Projective(), description="of the solver projective")
    strands: StrandsSolver = Field(StrandsSolver(), description="of the solver strands")
    xpbd: Xpbd = Field(Xpbd(), description="of the solver xpbd")
    time_step: TimeStep = Field(TimeStep(), description="how long a step may be")
    report: Measured = Field(Measured(), description="what metrics hold beside the usual")

    def particle_count(self) -> int:
        """Points of all pieces."""
        return sum(piece.point_count() for piece in self.pieces.values())

    def spring_count(self) -> int:
        """Springs of all pieces, estimated."""
        return sum(piece.spring_count() for piece in self.pieces.values())

    def memory_bytes(self) -> int:
        """State, rows of neighbours, and the factor."""
        factor = BYTES_OF_FACTOR if self.chosen_solver() == "projective" else 0
        count = self.particle_count()
        contact = BYTES_OF_CONTACT if self.contact.self_collision else 0
        return (
            (BYTES_PER_POINT + factor + contact) * count + BYTES_PER_SPRING * self.spring_count() + (1 << 20)
        )

    def seconds_per_step(self) -> float:
        """From the benchmark's figures."""
        solver = self.chosen_solver()
        each = SECONDS_PER_POINT[solver] + (SECONDS_OF_CONTACT if self.contact.self_collision else 0.0)
        return SECONDS_PER_STEP[solver] + each * self.particle_count()

    def largest_step(self) -> float:
        """Largest step [s] at the start: as asked for, or as the explicit solver bears."""
        explicit = self.chosen_solver() == "explicit"
        return min(self.time_step.asked(self.chosen_solver()), self.explicit_step if explicit else math.inf)

    def check_substeps(self, frame: float) -> None:
        """ValueError where a frame of so many seconds needs more than `time_step.most_substeps`."""
        step = self.largest_step()
        substeps = math.ceil(frame / step * (1.0 - 1e-9))
        refuse_substeps(substeps, self.time_step, step, self.chosen_solver())

    def chosen_solver(self) -> str:
        """The solver that steps: as given, or the one that suits."""
        if self.solver != "auto":
            return self.solver
        if self.need_explicit():
            return "explicit"
        if self.are_chains():
            return "strands"
        return "explicit" if self.explicit_step >= EXPLICIT_FROM else "projective"

    @property
    def explicit_step(self) -> float:
        """Longest step of the explicit solver [s]; infinity where it bears any, or cannot be known."""
        try:
            return self.explicit.safety * self._longest_first_step
        except SceneError:
            return math.inf  # the pieces cannot be built: `check_scene` says why

    @cached_property
    def _longest_first_step(self) -> float:
        return longest_first_step(self)

    def are_chains(self) -> bool:
        """Whether the solver `strands` can step all there is."""
        return not self.stitches and all(isinstance(piece, Rope | Strands) for piece in self.pieces.values())

    def need_explicit(self) -> list[str]:
        """What only the explicit solver can step."""
        pieces = self.pieces.values()
        hinges = any(isinstance(piece, Network) and piece.hinges for piece in pieces)
        solids = any(isinstance(piece, Solid) for piece in pieces)
        return [name for name, there in (("hinges", hinges), ("solids", solids)) if there]

    def check_scene(self, bounds: Bounds, body_names: Collection[str], system_names: Collection[str]) -> None:
        """Bodies that are named exist, bounds are not periodic; ValueError says which does not."""
        if bounds.kind == "periodic":
            raise ValueError("springs need bounds of kind open or contained, not periodic")
        named = [(f"pins.{name}.body", pin.body) for name, pin in self.pins.items() if pin.body is not None]
        named += [(f"contact.bodies.{name}", name) for name in self.contact.bodies]
        for place, body in named:
            if body not in body_names:
                raise ValueError(f"{place}: no body {body!r}; there are {', '.join(body_names) or 'none'}")
        try:
            _ = self._longest_first_step
        except SceneError as error:
            raise ValueError(str(error)) from None

    @model_validator(mode="after")
    def _solver_fits(self) -> Self:
        if self.solver == "strands" and not self.are_chains():
            raise ValueError("solver: strands is for ropes and strands alone, without stitches")
        needs = [name for name in self.need_explicit() if (self.solver, name) != ("xpbd", "hinges")]
        if self.solver not in ("auto", "explicit") and needs:
            raise ValueError(f"solver: {' and '.join(needs)} need explicit steps, not {self.solver}")
        return self

    @model_validator(mode="after")
    def _pieces_exist(self) -> Self:
        picks: dict[str, Pick] = {f"pins.{name}": pin for name, pin in self.pins.items()}
        picks |= {f"pushes.{name}": push for name, push in self.pushes.items()}
        for name, stitch in self.stitches.items():
            picks |= {f"stitches.{name}.first": stitch.first, f"stitches.{name}.second": stitch.second}
        for place, pick in picks.items():
            if pick.piece not in self.pieces:
                raise ValueError(
                    f"{place}.piece: no piece {pick.piece!r} in pieces; there are {', '.join(self.pieces)}"
                )
            count = self.pieces[pick.piece].point_count()
            if isinstance(pick.points, tuple) and pick.points and max(pick.points) >= count:
                raise ValueError(
                    f"{place}.points: no point {max(pick.points)}; {pick.piece} has 0 to {count - 1}"
                )
        if self.particle_count() > MOST_POINTS:
            raise ValueError(f"pieces: {self.particle_count():,} points; at most {MOST_POINTS:,}")
        return self
