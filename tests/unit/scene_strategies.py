"""Random valid scenes, drawn from the models: every kind of system, body, bounds, placement and behaviour.

Numbers are moderate (at most some hundreds in SI units) and counts small, with 0 and 1 among them, so that
a scene runs in a moment. A few fields of each model are drawn, the others keep their defaults.
"""

from typing import Any, Literal, get_args, get_origin

import annotated_types
from hypothesis import strategies as st
from pydantic import ValidationError
from scene_sites import FILES, NAME, OTHER_NAME, WORDS, accepts, base_bounds, example_of, files, valid

from tianim.params import Keyframes
from tianim.scene.fields import MAPPINGS, Model, bounds_of, field_annotation, kind_of, members, models, peel
from tianim.spatial.body_params import BodyParams
from tianim.systems import SYSTEMS

Raw = st.SearchStrategy[Any]

MODERATE = 100.0
LEAST = 0.01  # of what must be above 0: a radius of 1e-300 is valid and of no interest
MOST_ITEMS = 5
MOST_DRAWN_FIELDS = 3
FRAMES = 3
FPS = 30.0
# Bodies stand so far apart that none overlap: their sizes are moderate.
BODY_DISTANCE = 1000.0
BODY_NAMES = (NAME, OTHER_NAME)
# Files are made and a mesh is read here first: a temporary name and the mesh reader's import draw from
# `random`, which Hypothesis does not allow while it draws.
FOLDER = files()
for body in models(BodyParams):
    example_of(body)


def numbers(annotation: Any) -> Raw:
    limits = bounds_of(annotation)
    lower = limits.get("ge", limits.get("gt", -MODERATE))
    upper = limits.get("le", limits.get("lt", max(MODERATE, lower + 1.0)))
    lower, upper = max(lower, -MODERATE), min(upper, max(MODERATE, lower + 1.0))
    inner, _ = peel(annotation)
    if inner is int:
        step = int(limits.get("multiple_of", 1))
        return st.integers(int(lower), int(lower) + MOST_ITEMS).map(lambda value: value * step)
    if "gt" in limits:
        lower += LEAST
    if "lt" in limits:
        upper -= LEAST
    return st.floats(lower, upper, width=64).map(lambda value: round(value, 3))


def raw(annotation: Any) -> Raw:
    """Plain values that a field takes."""
    return st.one_of(*(_option(option) for option in members(annotation)))


def _option(option: Any) -> Raw:
    inner, metadata = peel(option)
    origin, arguments = get_origin(inner), get_args(inner)
    if origin is Literal:
        return st.sampled_from(arguments)
    if origin is tuple and arguments[-1] is Ellipsis:
        least = max(
            (item.min_length for item in metadata if isinstance(item, annotated_types.MinLen)), default=0
        )
        return st.lists(st.deferred(lambda: raw(arguments[0])), min_size=least, max_size=least + 2)
    if origin is tuple:
        return st.tuples(*(raw(argument) for argument in arguments)).map(list)
    if origin in MAPPINGS:
        return st.dictionaries(
            st.sampled_from(BODY_NAMES), st.deferred(lambda: raw(arguments[1])), max_size=1
        )
    if isinstance(inner, type) and issubclass(inner, Keyframes):
        return keyframes(inner)
    if models(option):
        return st.one_of(*(model(choice) for choice in models(option)))
    if inner in (float, int):
        return numbers(option)
    plain = {bool: st.booleans(), type(None): st.none()}.get(inner)
    if plain is not None:
        return plain
    known = [value for value in (*WORDS, *FILES) if accepts(option, value)]
    return st.sampled_from(known) if known else st.nothing()


@st.composite
def keyframes(draw: st.DrawFn, of: Model) -> dict[str, Any]:
    """Keyframes with rising times; a cubic curve may overshoot a limit, the filter drops it then."""
    (_, item), *_ = [get_args(get_args(of.model_fields["keys"].annotation)[0])]
    times = draw(st.lists(st.integers(0, 100), min_size=1, max_size=4, unique=True).map(sorted))
    return {
        "keys": [[time / 100, draw(_option(item))] for time in times],
        "interpolation": draw(st.sampled_from(("linear", "cubic", "pchip", "step"))),
        "repeat": draw(st.sampled_from(("none", "loop", "pingpong"))),
    }


def model(choice: Model) -> Raw:
    """A valid mapping for `choice`: what it requires, and a few other fields."""
    return _fields(choice).filter(lambda value: _fits(choice, value))


@st.composite
def _fields(draw: st.DrawFn, choice: Model) -> dict[str, Any]:
    kind = kind_of(choice)
    fields = {name: field for name, field in choice.model_fields.items() if kind is None or name != "kind"}
    wanted = [name for name, field in fields.items() if field.is_required() or name == "count"]
    others = [name for name in fields if name not in wanted]
    if others:
        wanted += draw(st.lists(st.sampled_from(others), unique=True, max_size=MOST_DRAWN_FIELDS))
    value = {} if kind is None else {"kind": kind}
    for name in wanted:
        annotation = field_annotation(fields[name])
        value[name] = draw(counts() if name == "count" else raw(annotation))
    return value


def counts() -> Raw:
    """Particles of a system: none and one are as likely as a few."""
    return st.sampled_from((0, 1)) | st.integers(2, 60)


def _fits(choice: Model, value: Any) -> bool:
    try:
        choice.model_validate(value, context={"folder": FOLDER})
    except ValidationError:
        return False
    return True


@st.composite
def scenes(draw: st.DrawFn) -> dict[str, Any]:
    """A valid scene as plain data, of `FRAMES` frames after the start."""
    kind = draw(st.sampled_from(sorted(SYSTEMS)))
    bodies = {}
    for index, name in enumerate(BODY_NAMES[: draw(st.integers(0, len(BODY_NAMES)))]):
        body = draw(model(draw(st.sampled_from(models(BodyParams)))))
        bodies[name] = {**body, "position": [BODY_DISTANCE * index, -BODY_DISTANCE * index, 0.0]}
    return {
        "tianim": 1,
        "fps": FPS,
        "duration": FRAMES / FPS,
        "seed": draw(st.integers(0, 2**32 - 1)),
        "bounds": dict(base_bounds(kind)),
        "bodies": bodies,
        "systems": {"main": draw(model(SYSTEMS[kind].params))},
    }


def valid_scenes() -> Raw:
    """Scenes whose parts fit together, too: a body that a target names is there."""
    return scenes().filter(valid)
