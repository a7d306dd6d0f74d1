"""tianim: particles, flocks and bodies for animation, simulated on a plain CPU.

    import tianim

    tianim.start(threads=2)
    scene = tianim.load_scene("configs/murmuration.yaml", ["boids.count=1000"])
    simulation = tianim.build(scene)
    for frame in simulation.frames():
        print(frame.time, frame.part("boids").position.mean(axis=0))

Names are imported when first used: importing this package starts nothing and loads nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tianim.errors import (
        BlowupError,
        FormatError,
        MissingPartError,
        OutputError,
        SceneError,
        TianimError,
    )
    from tianim.frame import Frame, Lines, Mesh, Points
    from tianim.run import simulate
    from tianim.run_folder import Run, RunOptions
    from tianim.runtime import start
    from tianim.scene import Scene, build, load_scene, scene_from
    from tianim.simulation import Simulation

__version__ = "0.1.0"

__all__ = [
    "BlowupError",
    "FormatError",
    "Frame",
    "Lines",
    "Mesh",
    "MissingPartError",
    "OutputError",
    "Points",
    "Run",
    "RunOptions",
    "Scene",
    "SceneError",
    "Simulation",
    "TianimError",
    "build",
    "load_scene",
    "scene_from",
    "simulate",
    "start",
]

_MODULES = {
    "errors": ("BlowupError", "FormatError", "MissingPartError", "OutputError", "SceneError", "TianimError"),
    "frame": ("Frame", "Lines", "Mesh", "Points"),
    "run": ("simulate",),
    "run_folder": ("Run", "RunOptions"),
    "runtime": ("start",),
    "scene": ("Scene", "build", "load_scene", "scene_from"),
    "simulation": ("Simulation",),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
