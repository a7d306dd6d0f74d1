"""Canvas: turns geometry, a camera and light into one picture.

The buffers live as long as the canvas; one draw is: find what is visible (raster), blend what is
translucent, find shadow and corners where wanted, shade.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from tianim.view import colormap, layout, liquid_light, raster, shade, shadow
from tianim.view.liquid import Liquid
from tianim.view.liquid_pass import LiquidPass, Scene

Float = NDArray[np.float32]
Int = NDArray[np.int32]
Picture = NDArray[np.uint8]
Key = NDArray[np.int64]

SHADOW_SIZE = 1024  # samples along each side of the shadow map
LARGEST_SCALE = 4096.0  # steps of the blended light in one unit
TILE = 16  # samples along each side of a tile of the shadow map

NO_PICTURE = np.empty((1, 1, 3), np.float32)
ENCODING = colormap.encoding_table(shade.ENCODING_SIZE, shade.ENCODING_STEPS)


def _rows(*shape: int, dtype: type = np.float32) -> NDArray:
    return np.zeros(shape, dtype)


@dataclass(frozen=True)
class Spheres:
    """Centres (n, 3) [m], radius (n,) [m], tone (n,): row of the colour table."""

    position: Float = field(default_factory=lambda: _rows(0, 3))
    radius: Float = field(default_factory=lambda: _rows(0))
    tone: Float = field(default_factory=lambda: _rows(0))


@dataclass(frozen=True)
class Triangles:
    """Vertices (n, 3) [m], their normals (zero: flat), triangles (m, 3), tone and tint per vertex."""

    position: Float = field(default_factory=lambda: _rows(0, 3))
    normal: Float = field(default_factory=lambda: _rows(0, 3))
    triangles: Int = field(default_factory=lambda: _rows(0, 3, dtype=np.int32))
    tone: Float = field(default_factory=lambda: _rows(0))
    tint: Float = field(default_factory=lambda: _rows(0))


@dataclass(frozen=True)
class Sticks:
    """Points (n, 3) [m], segments (m, 2), radius [m] and tone per segment."""

    position: Float = field(default_factory=lambda: _rows(0, 3))
    segments: Int = field(default_factory=lambda: _rows(0, 2, dtype=np.int32))
    radius: Float = field(default_factory=lambda: _rows(0))
    tone: Float = field(default_factory=lambda: _rows(0))


@dataclass(frozen=True)
class Blend:
    """Translucent sticks from tail to head (n, 3) [m]; radius [m], opacity, tone (n,).

    `taper`: width of the tail over that of the head; `joined`: sticks of a trail; `glow` above 0
    adds light of that strength.
    """

    tail: Float
    head: Float
    radius: Float
    opacity: Float
    tone: Float
    taper: float = 1.0
    joined: bool = False
    glow: float = 0.0


@dataclass(frozen=True)
class Geometry:
    """All that one picture shows; `colors` (rows, 3) is the table that tones point into."""

    colors: Float
    spheres: Spheres = Spheres()
    triangles: Triangles = Triangles()
    sticks: Sticks = Sticks()
    blends: Sequence[Blend] = ()
    liquids: Sequence[Liquid] = ()


@dataclass(frozen=True)
class Light:
    """How a picture is lit.

    stage  see layout; fog: start [m], length [m], share lost over it
    sun    camera of the shadow map, None: no shadows are cast; reach: how far a corner darkens [m]
    mirror what liquids mirror (see environment), None: there are none
    distance, radius  of the action [m]
    """

    stage: Float
    fog: Float
    sun: Float | None = None
    reach: float = 1.0
    mirror: Float | None = None
    distance: float = 1.0
    radius: float = 1.0


class Canvas:
    """Buffers for pictures of one size, `samples` squared samples a pixel."""

    def __init__(self, width: int, height: int, samples: int) -> None:
        self.width, self.height, self.samples = width, height, samples
        self._key = np.empty((height * samples, width * samples), np.int64)
        self._light = np.empty((height, width, 2), np.int64)
        self._depth = np.empty((height, width), np.float32)
        self._shade = np.empty((height, width, 2), np.float32)
        self._shadow = np.empty((SHADOW_SIZE, SHADOW_SIZE), np.int64)
        self._liquids: LiquidPass | None = None  # made when the first liquid is seen

    def draw(self, geometry: Geometry, camera: Float, light: Light, background: Float) -> Picture:
        """The picture (height, width, 3); `camera` is for whole pixels, `background` as large, linear."""
        fine = camera.copy()
        fine[[layout.FOCAL, layout.WIDTH, layout.HEIGHT]] *= self.samples
        self._see(self._key, geometry, fine)
        scale = self._blend(self._light, self._key, geometry, camera, light, background)
        liquids = self._see_liquids(geometry, fine)
        if liquids is not None and geometry.blends:
            self._blend(liquids.light, liquids.nearest, geometry, camera, light, background)
            self._light -= liquids.light  # what lies behind the liquids is left
        if light.stage[layout.CORNER] > 0.0 or light.sun is not None:
            self._find_shade(geometry, camera, light)
        out = np.empty((self.height, self.width, 3), np.uint8)
        spheres, mesh, sticks = geometry.spheres, geometry.triangles, geometry.sticks
        shade.resolve(
            out, self._key, fine, light.stage, light.fog, background,
            self._shade, self._depth, light.reach, self._light, scale,
            spheres.position, spheres.radius, spheres.tone,
            mesh.position, mesh.normal, mesh.triangles, mesh.tone, mesh.tint,
            sticks.position, sticks.segments, sticks.radius, sticks.tone, geometry.colors, ENCODING,
            NO_PICTURE if liquids is None else liquids.picture,
        )  # fmt: skip
        if liquids is not None and light.mirror is not None:
            shadow.scene_depth(self._depth, self._key, camera, light.stage)
            scene = Scene(
                camera, light.stage, light.fog, background, light.mirror, light.distance, light.radius,
                light.sun, self._shade,
            )  # fmt: skip
            liquids.draw(self._depth, scene)
            liquid_light.finish(out, liquids.picture, liquids.light, scale, ENCODING)
        return out

    def _see_liquids(self, geometry: Geometry, fine: Float) -> LiquidPass | None:
        """The pass that draws the liquids, once it has seen them; None where there are none."""
        if not geometry.liquids:
            return None
        if self._liquids is None:
            self._liquids = LiquidPass(self.width, self.height, self.samples)
        self._liquids.light.fill(0)
        self._liquids.see(geometry.liquids, self._key, fine)
        return self._liquids

    def _find_shade(self, geometry: Geometry, camera: Float, light: Light) -> None:
        """Fill the buffer of corners and cast shadows."""
        shadow.scene_depth(self._depth, self._key, camera, light.stage)
        casters: Float = np.full((1, 1), layout.FAR, np.float32)
        if light.sun is not None:
            self._see(self._shadow, geometry, light.sun)
            casters = self._casters()
        sun = camera if light.sun is None else light.sun
        shadow.find_shade(
            self._shade, self._depth, self._shadow, casters, camera, sun, light.stage, light.reach
        )

    def _casters(self) -> Float:
        """Nearest depth of the shadow map in and round each tile, so that most points look no further."""
        tiles = SHADOW_SIZE // TILE
        nearest = self._shadow.reshape(tiles, TILE, tiles, TILE).min(axis=(1, 3))
        depth = (nearest >> 32).astype(np.int32).view(np.float32)
        depth = np.where(nearest == layout.EMPTY, np.float32(layout.FAR), depth)
        reach = 2 * int(np.ceil(shadow.LARGEST_PENUMBRA * SHADOW_SIZE / TILE)) + 1
        return np.ascontiguousarray(minimum_filter(depth, size=reach), dtype=np.float32)

    def _see(self, key: NDArray[np.int64], geometry: Geometry, camera: Float) -> None:
        """Fill `key` with the nearest primitive at each sample."""
        key.fill(layout.EMPTY)
        spheres, mesh, sticks = geometry.spheres, geometry.triangles, geometry.sticks
        first_triangle = len(spheres.position)
        first_line = first_triangle + len(mesh.triangles)
        if first_triangle:
            raster.raster_spheres(key, camera, spheres.position, spheres.radius, 0)
        if len(mesh.triangles):
            raster.raster_triangles(key, camera, mesh.position, mesh.triangles, first_triangle)
        if len(sticks.segments):
            raster.raster_lines(key, camera, sticks.position, sticks.segments, sticks.radius, first_line)

    def _blend(
        self, out: Key, key: Key, geometry: Geometry, camera: Float, light: Light, background: Float
    ) -> float:
        """Fill `out` with blended light; returns its steps in one unit, chosen so that no sum overflows."""
        out.fill(0)
        count = sum(len(blend.tail) for blend in geometry.blends)
        scale = min(LARGEST_SCALE, 2.0**31 / (4.0 * max(count, 1)))
        for blend in geometry.blends:
            raster.blend_capsules(
                out, key, camera, light.fog, background, blend.tail, blend.head, blend.radius,
                blend.opacity, blend.tone, geometry.colors, blend.taper, int(blend.joined), blend.glow, scale,
            )  # fmt: skip
        return scale
