"""From a Scene to a Simulation that is ready to run."""

import hashlib

from tianim.errors import SceneError
from tianim.scene.models import Scene
from tianim.scene.summary import check_memory
from tianim.simulation import Simulation
from tianim.spatial.bodies import Bodies
from tianim.system import System, SystemParams, World
from tianim.systems import SYSTEMS


def build(scene: Scene) -> Simulation:
    """The simulation of `scene` at its start.

    Raises SceneError where this machine cannot hold it, or a system finds at its start what does not fit.
    """
    check_memory(scene)
    bodies, bounds = Bodies(scene.bodies), scene.bounds.value()
    fields = None if scene.output.fields == "all" else frozenset(scene.output.fields)
    systems = {
        name: _system(name, params, World(bounds, bodies, system_seed(scene.seed, name), fields))
        for name, params in scene.systems.items()
    }
    simulation = Simulation(systems, bodies, scene.fps, scene.frame_count, bounds)
    if scene.frame_count > 1:  # a start alone may have a frame time of any length
        simulation.check_substeps()
    return simulation


def _system(name: str, params: SystemParams, world: World) -> System:
    try:
        return SYSTEMS[params.kind].system(name, params, world)
    except SceneError as error:
        raise SceneError(f"systems.{name}: {error}") from None


def system_seed(seed: int, name: str) -> int:
    """A system's own seed, 0 to 2^31 - 1: the same on every machine, whatever other systems there are."""
    digest = hashlib.blake2b(f"{seed} {name}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little") & 0x7FFFFFFF
