"""The fluid at the start: blocks filled with particles, and refused where they stand in each other's way.

Nothing may start in a wall, in a body or in another block: such particles would be shot out. A block
that says `carve` leaves them out instead. The first of several blocks keeps its place.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tianim.errors import SceneError
from tianim.spatial.bodies import Bodies
from tianim.spatial.point_files import read_points
from tianim.system import Bounds
from tianim.systems.fluid.block_params import ROUNDING, BlockParams, BoxBlock, PointsBlock
from tianim.systems.fluid.clearance import as_text, distance_error, nearest_body, room_in_bounds
from tianim.systems.fluid.lattices import Lattice, lattice_of, within
from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.settling import rest_pressure

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Distance of a particle's centre from a wall [spacings]: boxes start exactly half a spacing away. The
# points of a ball or a mesh fall as they may, and a quarter is what walls keep free in any case.
BOX_GAP, LEAST_GAP = 0.5, 0.25
# Places, which are float32, must be exact to this at the start [spacings].
EXACT = 0.05
# Points nearer than this are one point given twice [spacings]; those of a frame of a splash come to 0.04.
SAME = 0.01


class Filled(NamedTuple):
    """Particles at the start, block after block.

    position (n, 3) [m], velocity (n, 3) [m/s], phase (n,), pressure (n,) [Pa] where a block is settled
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    phase: NDArray[np.int32]
    pressure: NDArray[np.float32]


class _Placed(NamedTuple):
    """A block's particles: places and velocities, and the lattice that they stand on, if any."""

    position: Floats
    velocity: Floats
    lattice: Lattice | None
    place: NDArray[np.int64]


def fill(params: FluidParams, bounds: Bounds, bodies: Bodies) -> Filled:
    """All blocks as particles. SceneError says which block is in the way of what, how much, and where."""
    placed: dict[str, _Placed] = {}
    for name, block in params.blocks.items():
        new = _place(name, block, params)
        _check_exact(name, new.position, params.spacing)
        new = _clear_of_walls(name, block, new, params, bounds, bodies)
        placed[name] = _clear_of_blocks(name, block, new, placed, params)
    filled = _joined(params, placed)
    count = len(filled.position)
    if params.capacity is not None and count > params.capacity:
        raise SceneError(f"capacity {params.capacity:,}: the blocks alone hold {count:,} particles")
    if count == 0 and not params.emitters:
        wanted = params.block_count()
        raise SceneError(f"blocks: carve leaves out all {wanted:,} particles, and there is no emitter")
    if not any(block.settled for block in params.blocks.values()):
        return filled
    return filled._replace(pressure=_settled(params, placed, filled, bodies))


def _place(name: str, block: BlockParams, params: FluidParams) -> _Placed:
    if isinstance(block, PointsBlock):
        x, v = _given_points(block, params.dimension)
        _check_apart(name, x, params.spacing)
        return _Placed(x, v + np.array(block.velocity), None, np.arange(len(x)))
    lattice = lattice_of(block, params.spacing, params.dimension)
    index = np.flatnonzero(within(block, lattice, params.dimension, ROUNDING * params.spacing))
    if len(index) == 0:
        raise SceneError(f"blocks.{name}: holds no particle at a spacing of {params.spacing:g} m")
    velocity = np.tile(np.array(block.velocity, np.float64), (len(index), 1))
    return _Placed(lattice.points()[index], velocity, lattice, index)


def _given_points(block: PointsBlock, dimension: int) -> tuple[Floats, Floats]:
    if block.file is None:
        x, v = np.array(block.positions, np.float64), None
    else:
        x, v = read_points(block.file)
    x, v = x.copy(), np.zeros_like(x) if v is None else v.copy()
    x[:, dimension:] = v[:, dimension:] = 0.0
    return x, v


def _check_apart(name: str, x: Floats, spacing: float) -> None:
    """SceneError where points of a block are in one place: no force could part them."""
    if len(x) < 2:
        return
    bad = cKDTree(x).query(x, k=2)[0][:, 1] < SAME * spacing
    if bad.any():
        raise SceneError(
            f"blocks.{name}: {_share(bad)} are nearer than {SAME:g} spacings to another of them, "
            f"the first at {as_text(x[np.argmax(bad)])}"
        )


def _check_exact(name: str, x: Floats, spacing: float) -> None:
    """SceneError where a block lies so far away that its particles would fall together by rounding."""
    farthest = float(np.abs(x).max(initial=0.0))
    step = float(np.spacing(np.float32(farthest)))
    if step > EXACT * spacing:
        raise SceneError(
            f"blocks.{name}: reaches {farthest:g} m away from the origin, where places are exact to "
            f"{step:.2g} m only; with a spacing of {spacing:g} m it must lie where they are to "
            f"{EXACT * spacing:.2g} m"
        )


def _kept(placed: _Placed, keep: Mask) -> _Placed:
    return placed._replace(
        position=placed.position[keep], velocity=placed.velocity[keep], place=placed.place[keep]
    )


def _clear_of_walls(
    name: str, block: BlockParams, placed: _Placed, params: FluidParams, bounds: Bounds, bodies: Bodies
) -> _Placed:
    """Without the particles in walls, or an error."""
    d = params.spacing
    gap = BOX_GAP if isinstance(block, BoxBlock) or block.carve else LEAST_GAP
    room = {"the bounds": room_in_bounds(placed.position, bounds, params.dimension) - gap * d}
    if bounds.kind != "contained":
        room["the bounds"] += gap * d  # no walls: the other side is there
    if bodies.count:
        distance = bodies.distance(placed.position)[0].astype(np.float64)
        room["a body"] = distance - gap * d + distance_error(bodies)
    for what, free in room.items():
        bad = free < -ROUNDING * d
        if bad.any() and not block.carve:
            first = placed.position[np.argmax(bad)]
            wall = what if what == "the bounds" else f"bodies.{nearest_body(bodies, first)}"
            raise SceneError(
                f"blocks.{name}: {_share(bad)} start in {wall} or nearer than {gap:g} spacings to it, "
                f"the first at {as_text(first)}: move the block, or carve: true leaves them out"
            )
    keep = np.all([free >= -ROUNDING * d for free in room.values()], axis=0)
    return _kept(placed, keep)


def _clear_of_blocks(
    name: str, block: BlockParams, new: _Placed, earlier: dict[str, _Placed], params: FluidParams
) -> _Placed:
    """Without the particles in earlier blocks, or an error."""
    for other, there in earlier.items():
        bad = _overlap(block, new, params.blocks[other], there, params)
        if bad.any() and not block.carve:
            first = new.position[np.argmax(bad)]
            raise SceneError(
                f"blocks.{name}: {_share(bad)} overlap blocks.{other}, the first at {as_text(first)}: "
                "move one of the two, or carve: true leaves them out"
            )
        new = _kept(new, ~bad)
    return new


def _overlap(
    block: BlockParams, new: _Placed, other: BlockParams, there: _Placed, params: FluidParams
) -> Mask:
    """Which particles of a block stand in another block."""
    d = params.spacing
    if len(new.position) == 0 or len(there.position) == 0:
        return np.zeros(len(new.position), np.bool_)
    near = np.all(
        (new.position > there.position.min(axis=0) - d) & (new.position < there.position.max(axis=0) + d),
        axis=1,
    )
    bad = np.zeros(len(near), np.bool_)
    if not near.any():
        return bad
    # Blocks that touch have particles half a spacing apart at least: a ball's reach to its very surface.
    tree = cKDTree(there.position)
    bad[near] = tree.query(new.position[near])[0] < (0.5 - ROUNDING) * d
    if new.lattice is not None and not isinstance(other, PointsBlock):
        boxes = isinstance(block, BoxBlock) and isinstance(other, BoxBlock)
        margin = (0.5 if boxes else 0.0) - ROUNDING
        bad |= within(other, new.lattice, params.dimension, margin * d)[new.place] & near
    return bad


def _share(bad: Mask) -> str:
    return f"{np.count_nonzero(bad):,} of its {len(bad):,} particles"


def _joined(params: FluidParams, placed: dict[str, _Placed]) -> Filled:
    """Blocks one behind the other."""
    position = np.concatenate([np.zeros((0, 3)), *(block.position for block in placed.values())])
    velocity = np.concatenate([np.zeros((0, 3)), *(block.velocity for block in placed.values())])
    numbers = [
        np.full(len(block.position), params.phase_number(params.blocks[name].phase), np.int32)
        for name, block in placed.items()
    ]
    if params.dimension == 2:
        velocity[:, 2] = 0.0
    return Filled(
        position.astype(np.float32),
        velocity.astype(np.float32),
        np.concatenate([np.zeros(0, np.int32), *numbers]),
        np.zeros(len(position), np.float32),
    )


def _settled(
    params: FluidParams, placed: dict[str, _Placed], filled: Filled, bodies: Bodies
) -> NDArray[np.float32]:
    """Pressure of rest [Pa] in the blocks that are settled, 0 in the others."""
    densities = np.array([phase.density for phase in params.all_phases()])
    gravity = np.array(params.at(0.0).gravity)
    gravity[params.dimension :] = 0.0
    position = filled.position.astype(np.float64)
    pressure = rest_pressure(position, densities[filled.phase], gravity, params.spacing, bodies)
    settled = [np.full(len(block.position), params.blocks[name].settled) for name, block in placed.items()]
    return np.where(np.concatenate(settled), pressure, 0.0).astype(np.float32)
