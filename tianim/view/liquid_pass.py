"""Liquid pass: draws liquids over the picture of all that is solid, the farthest first."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.view import layout, liquid, liquid_light, raster
from tianim.view.caustics import Caustics
from tianim.view.liquid import Liquid

Float = NDArray[np.float32]
Int = NDArray[np.int32]
Key = NDArray[np.int64]


@dataclass(frozen=True)
class Scene:
    """What a liquid is drawn into: see `liquid_light.compose`; `radius` of the action [m].

    sun: camera of the shadow map, None where no light is cast; shade as in shadow.find_shade.
    """

    camera: Float
    stage: Float
    fog: Float
    background: Float
    mirror: Float
    distance: float
    radius: float
    sun: Float | None
    shade: Float


class LiquidPass:
    """Buffers for liquids in pictures of one size; `nearest` is the key with all liquids in it."""

    def __init__(self, width: int, height: int, samples: int) -> None:
        self._shape, self._fine = (height, width), (height * samples, width * samples)
        self.nearest: Key = np.empty(self._fine, np.int64)
        self.light: Key = np.zeros((height, width, 2), np.int64)
        self.picture: Float = np.empty((height, width, 3), np.float32)
        self._other: Float = np.empty((height, width, 3), np.float32)
        self._total: Key = np.empty((height, width), np.int64)
        self._thickness: Float = np.empty((height, width), np.float32)
        self._caustics = Caustics()
        self._seen: list[tuple[Liquid, Float]] = []

    def see(self, liquids: Sequence[Liquid], solid: Key, fine: Float) -> None:
        """Find the front of each liquid before what is `solid`; `fine` is the camera of samples."""
        self.nearest[:] = solid
        self._seen = []
        key = np.empty(self._fine, np.int64)
        for one in sorted(liquids, key=lambda one: -_depth_of(one, fine)):
            key.fill(layout.EMPTY)
            raster.raster_triangles(key, fine, one.position, one.triangles, 0)
            front = np.empty((*self._shape, liquid.FRONT), np.float32)
            liquid.gather_front(front, key, solid, fine, one.position, one.normal, one.triangles)
            np.minimum(self.nearest, key, out=self.nearest)
            self._seen.append((one, front))

    def draw(self, depth: Float, scene: Scene) -> None:
        """Draw the liquids into `picture`; `depth` [m] of what is solid comes to hold theirs too."""
        if scene.sun is not None:
            for one, _ in self._seen:
                self._caustics.cast(
                    self.picture, depth, scene.shade, one, scene.camera, scene.sun, scene.stage, scene.radius
                )
        unit = scene.distance / liquid.STEPS
        farthest = scene.distance + 1.5 * scene.radius
        for one, front in self._seen:
            self._total.fill(0)
            liquid.add_faces(self._total, scene.camera, depth, one.position, one.triangles, unit)
            liquid.find_thickness(self._thickness, self._total, front, depth, unit, 0.3 * scene.radius)
            liquid_light.compose(
                self._other, self.picture, front, self._thickness, depth, scene.camera, scene.stage,
                scene.fog, scene.background, scene.mirror, one.substance.row, farthest,
            )  # fmt: skip
            self.picture, self._other = self._other, self.picture
            np.minimum(depth, np.where(front[..., 0] > 0.5, front[..., 1], layout.FAR), out=depth)


def _depth_of(one: Liquid, camera: Float) -> float:
    """Mean depth of a liquid as the camera sees it [m]; what nothing shines through comes first."""
    if not len(one.position):
        return 0.0
    return float((one.position.mean(axis=0) - camera[:3]) @ camera[9:12])
