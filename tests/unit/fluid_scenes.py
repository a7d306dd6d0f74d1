"""Fluids for tests: parameters from short words, bodies and bounds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from tianim.spatial.bodies import Bodies
from tianim.spatial.body_params import BodyParams
from tianim.system import Bounds
from tianim.systems.fluid.fill import Filled, fill
from tianim.systems.fluid.params import FluidParams

OPEN = Bounds()


def floats(value: Any) -> Any:
    """Whole numbers in vectors as floats, as the scene's loader has them."""
    if isinstance(value, dict):
        return {key: floats(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [float(item) if type(item) is int else floats(item) for item in value]
    return value


def fluid(**fields: Any) -> FluidParams:
    """A fluid of spacing 0.1 where nothing else is said."""
    return FluidParams.model_validate({"kind": "fluid", "spacing": 0.1, **floats(fields)})


def box(lower: Any, upper: Any, **more: Any) -> dict[str, Any]:
    return {"kind": "box", "lower": lower, "upper": upper, **more}


def bodies(**given: Mapping[str, Any]) -> Bodies:
    adapter: TypeAdapter[Any] = TypeAdapter(BodyParams)
    return Bodies({name: adapter.validate_python(floats(dict(body))) for name, body in given.items()})


def contained(lower: Any, upper: Any, kind: str = "contained") -> Bounds:
    (a, b, c), (d, e, f) = lower, upper
    return Bounds(kind, (float(a), float(b), float(c)), (float(d), float(e), float(f)))


def filled(bounds: Bounds = OPEN, solid: Bodies | None = None, **fields: Any) -> Filled:
    return fill(fluid(**fields), bounds, solid or bodies())


def write_box_mesh(path: Path, size: tuple[float, float, float], lid: bool = True) -> Path:
    """A box about the origin as OFF; without its lid an open mesh."""
    corners = [[(k >> c & 1) - 0.5 for c in range(3)] for k in range(8)]
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (0, 2, 3, 1), (4, 5, 7, 6)]
    quads += [(2, 6, 7, 3)] if lid else []
    lines = [f"3 {a} {b} {c}\n3 {a} {c} {d}" for a, b, c, d in quads]
    points = [" ".join(f"{value}" for value in np.multiply(corner, size)) for corner in corners]
    path.write_text("\n".join(["OFF", f"8 {2 * len(quads)} 0", *points, *lines]) + "\n")
    return path


def nearest_neighbour(x: NDArray[np.floating]) -> NDArray[np.float64]:
    """Distance of each point from the next [m]."""
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(x.astype(np.float64)).query(x, k=2)[0][:, 1])
