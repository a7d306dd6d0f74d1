"""The table of systems: one line each. Adding a system means a file, a line here, a test file."""

from collections.abc import Callable
from typing import Any, NamedTuple

from tianim.system import System, SystemParams, World
from tianim.systems.boids import Boids, BoidsParams
from tianim.systems.boids.couzin import Couzin, CouzinParams
from tianim.systems.boids.vicsek import Vicsek, VicsekParams
from tianim.systems.fluid import Fluid, FluidParams
from tianim.systems.gravity import Gravity, GravityParams
from tianim.systems.springs import SpringsParams, SpringSystem


class SystemKind(NamedTuple):
    """A kind of system: its parameters and its class, built as `system(name, params, world)`."""

    params: type[SystemParams]
    system: Callable[[str, Any, World], System]


SYSTEMS: dict[str, SystemKind] = {
    "boids": SystemKind(BoidsParams, Boids),
    "couzin": SystemKind(CouzinParams, Couzin),
    "fluid": SystemKind(FluidParams, Fluid),
    "gravity": SystemKind(GravityParams, Gravity),
    "springs": SystemKind(SpringsParams, SpringSystem),
    "vicsek": SystemKind(VicsekParams, Vicsek),
}

__all__ = ["SYSTEMS", "System", "SystemKind", "SystemParams", "World"]
