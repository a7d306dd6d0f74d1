"""Scenes: loading, checking and building them. Names are imported when first used.

scene = load_scene("configs/murmuration.yaml", ["boids.count=1000"])
simulation = build(scene)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tianim.scene.building import build
    from tianim.scene.loading import SceneFile, find_scenes
    from tianim.scene.models import Scene
    from tianim.scene.schema import describe, json_schema
    from tianim.scene.summary import Summary, check_memory, summarise
    from tianim.scene.validation import load_scene, scene_from

__all__ = [
    "Scene",
    "SceneFile",
    "Summary",
    "build",
    "check_memory",
    "describe",
    "find_scenes",
    "json_schema",
    "load_scene",
    "scene_from",
    "summarise",
]

_MODULES = {
    "build": "building",
    "SceneFile": "loading",
    "find_scenes": "loading",
    "Scene": "models",
    "describe": "schema",
    "json_schema": "schema",
    "Summary": "summary",
    "check_memory": "summary",
    "summarise": "summary",
    "load_scene": "validation",
    "scene_from": "validation",
}


def __getattr__(name: str) -> Any:
    """Import what is asked for: the light commands need neither pydantic models nor kernels."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
