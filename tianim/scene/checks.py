"""What must fit together in a scene, beyond what each part says of itself."""

from collections.abc import Iterator
from itertools import combinations

from tianim.scene.errors import Problem
from tianim.scene.models import MOST_FRAMES, Scene
from tianim.simulation import MOST_SUBSTEPS
from tianim.spatial.body_overlap import overlap

# Bodies that touch are welcome: a ball on a floor reaches into it by this much through rounding [m].
TOUCHING = 1e-6
# Pairs of bodies that are compared, each some 0.3 ms; a scene of more bodies than this goes unchecked.
MOST_PAIRS = 10_000


def problems_between(scene: Scene) -> list[Problem]:
    """Problems between the parts of a scene whose parts are valid."""
    return [*_length(scene), *_names(scene), *_steps(scene), *_overlaps(scene), *_systems(scene)]


def _length(scene: Scene) -> Iterator[Problem]:
    if scene.frame_count > MOST_FRAMES:
        message = (
            f"at {scene.fps:g} frames a second gives {scene.frame_count:,} frames; at most {MOST_FRAMES:,}"
        )
        yield Problem(("duration",), message, scene.duration)


def _names(scene: Scene) -> Iterator[Problem]:
    for name in scene.systems:
        if name in scene.bodies:
            yield Problem(("systems", name), f"a system and a body have one name: {name!r}")


def _steps(scene: Scene) -> Iterator[Problem]:
    for name, params in scene.systems.items():
        step = params.largest_step()
        if scene.frame_count > 1 and 1.0 / scene.fps > MOST_SUBSTEPS * step:
            message = f"a frame would need more than {MOST_SUBSTEPS:,} substeps of {step:g} s"
            yield Problem(("systems", name), message)
        elif scene.frame_count > 1:
            try:
                params.check_substeps(1.0 / scene.fps)
            except ValueError as error:
                yield Problem(("systems", name), str(error))


def _overlaps(scene: Scene) -> Iterator[Problem]:
    """Solid bodies that reach into each other at time 0 push what is between them both ways."""
    bodies = {name: body.at(0.0) for name, body in scene.bodies.items()}
    if len(bodies) * (len(bodies) - 1) // 2 > MOST_PAIRS:
        return
    for (one, first), (other, second) in combinations(bodies.items(), 2):
        depth = overlap(first, second)
        if depth is not None and depth > TOUCHING:
            message = f"overlaps bodies.{one} by {depth:.3g} m at time 0; bodies may touch but not overlap"
            yield Problem(("bodies", other), message)


def _systems(scene: Scene) -> Iterator[Problem]:
    """Each system says what it needs of the rest."""
    for name, params in scene.systems.items():
        try:
            params.check_scene(scene.bounds.value(), tuple(scene.bodies), tuple(scene.systems))
        except ValueError as error:
            yield Problem(("systems", name), " ".join(str(error).split()))
