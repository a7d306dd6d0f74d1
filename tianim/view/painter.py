"""Painter: the pictures of a film, one index at a time.

It surveys the film once, decides background, camera and styles, and then draws any frame.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Frame, Mesh
from tianim.view.backdrop import (
    Backdrop,
    Background,
    Preset,
    preset_of,
    stage_array,
    with_floor,
    with_shadows,
)
from tianim.view.camera import CameraPath, Stand, View, camera_array
from tianim.view.canvas import SHADOW_SIZE, Canvas, Geometry, Light, Picture
from tianim.view.draft import Draft, nearest_first
from tianim.view.environment import environment
from tianim.view.layout import FOCAL, PERSPECTIVE, SHADOW
from tianim.view.look import Look
from tianim.view.shadow import light_pool
from tianim.view.starlight import Starlight
from tianim.view.styles import Styles
from tianim.view.survey import Frames, Survey, survey
from tianim.view.wet import ELEVATION_SKY, ELEVATION_TANK, FILL_TANK, any_fluid, is_wet

Float = NDArray[np.float32]

CORNER_REACH = 0.06  # how far corners are looked for, over the radius of the action
SHADOW_REACH = 2.2  # half the width of the shadow map, over the radius of the action
POOL_REACH = 1.5  # width of the pool of light on a dark floor, over the radius of the action
MANY = 400_000  # points from which one sample a pixel must do


class Painter:
    """Draws frames of one film by one look; `survey`, `path`, `draft` and `backdrop` are what it decided."""

    def __init__(self, frames: Frames, look: Look) -> None:
        self._frames, self._look = frames, look
        self.survey: Survey = survey(frames, unframed(look))
        self.background = background_for(look, self.survey)
        wet = is_wet(look, self.survey.parts)
        preset = with_floor(preset_of(self.background), look.floor, wet)
        self._preset: Preset = with_shadows(preset, look.shadows)
        size = (look.width, look.height)
        stand = Stand(self._preset.azimuth, self._preset.elevation)
        if wet:
            elevation = ELEVATION_SKY if self._preset.sky else ELEVATION_TANK
            stand = Stand(self._preset.azimuth, elevation, FILL_TANK)
        girth = 0.5 * max((style.size or 0.0 for style in look.parts.values()), default=0.0)
        self.path = CameraPath(look.camera, self.survey, *size, stand, girth)
        middle = int(self.survey.indices[len(self.survey.indices) // 2]) if len(self.survey.indices) else 0
        typical = self.path.at(middle, self._time(middle))
        # Metres that a pixel covers at the action, were the picture 720 rows high.
        w = typical.distance if typical.camera[PERSPECTIVE] > 0.5 else 1.0
        pixel = w / float(typical.camera[FOCAL]) * look.height / 720.0
        styles = Styles(look, self._preset, self.survey, pixel, typical.radius)
        self.draft = Draft(styles, self.survey.flat)
        self._canvas = Canvas(*size, look.samples or samples_for(self.survey))
        self.backdrop = Backdrop(self._preset, *size)
        self._fog = self._preset.fog if look.fog is None else look.fog
        self._mirror = environment(self._preset) * np.float32(look.exposure)
        self._starlight = self._exposed_starlight()

    @property
    def trail(self) -> int:
        """Frames before the present one that a picture wants to see."""
        return self.draft.trail

    def picture(self, index: int) -> Picture:
        """The picture (height, width, 3) uint8 of the frame at `index`."""
        earlier = [self._frames[k] for k in range(max(0, index - self.trail), index)]
        return self.draw(self._frames[index], index, earlier)

    def draw(self, frame: Frame, index: int, earlier: Sequence[Frame] = ()) -> Picture:
        """The picture of `frame`, which is at `index` of the film, with trails through `earlier`."""
        view = self.path.at(index, frame.time)
        geometry = self.draft.geometry(frame, earlier)
        if self.survey.fluid:
            geometry = nearest_first(geometry, view.camera)
        background = self.backdrop.picture(view.camera, frame.time)
        if self._preset.pool is not None:
            background = self._pooled(background, view)
        if self._starlight is not None:
            stars = self.draft.stars(frame)
            background = self._starlight.picture(stars, view.camera, self.draft.colors, background)
        return self._canvas.draw(geometry, view.camera, self._light(view, geometry), background)

    def _pooled(self, background: Float, view: View) -> Float:
        """The background with a pool of light on the floor round the action."""
        out = np.empty_like(background)
        stage = stage_array(self._preset, view.camera, self.survey.lowest, self._look.exposure)
        center = view.camera[:3] + view.camera[9:12] * np.float32(view.distance)
        pool = np.array(
            [center[0], center[2], POOL_REACH * view.radius, *(self._preset.pool or ())], np.float32
        )
        light_pool(out, background, view.camera, stage, pool)
        return out

    def _exposed_starlight(self) -> Starlight | None:
        """Starlight, exposed for the whole film; None where there are no stars."""
        if "stars" not in {style.kind for style in self._look.parts.values()}:
            return None
        starlight = Starlight(self._look.width, self._look.height, self._look.exposure)
        indices = self.survey.indices
        typical = []
        for place in sorted({0, len(indices) // 2, len(indices) - 1}) if len(indices) else ():
            index = int(indices[place])
            frame = self._frames[index]
            typical.append((self.draft.stars(frame), self.path.at(index, frame.time).camera))
        starlight.expose(typical, self.draft.colors)
        return starlight

    def _time(self, index: int) -> float:
        found = np.flatnonzero(self.survey.indices == index)
        return float(self.survey.times[found[0]]) if len(found) else 0.0

    def _light(self, view: View, geometry: Geometry) -> Light:
        stage = stage_array(self._preset, view.camera, self.survey.lowest, self._look.exposure)
        start = view.distance - view.radius
        fog = np.array([start, max(2 * view.radius, 1e-9), min(self._fog, 0.995)], np.float32)
        sun = None
        solid = (
            len(geometry.spheres.position) + len(geometry.triangles.triangles)
            + len(geometry.sticks.segments) + len(geometry.liquids)
        )  # fmt: skip
        if self._preset.shadow > 0.0 and solid:
            sun = self._sun(view, stage[:3].astype(np.float64))
        else:
            stage[SHADOW] = 0.0
        reach = CORNER_REACH * view.radius
        return Light(stage, fog, sun, reach, self._mirror, view.distance, view.radius)

    def _sun(self, view: View, toward: NDArray[np.float64]) -> Float:
        """Orthographic camera of the shadow map, round the action."""
        eye, forward = view.camera[:3].astype(np.float64), view.camera[9:12].astype(np.float64)
        center = eye + forward * view.distance
        reach = SHADOW_REACH * view.radius
        up = np.array([0.0, 0.0, 1.0]) if abs(toward[1]) > 0.9 else np.array([0.0, 1.0, 0.0])
        return camera_array(center + toward * 4 * reach, center, SHADOW_SIZE, SHADOW_SIZE, reach, False, up)


def check_look(frame: Frame, look: Look) -> None:
    """Raise SceneError where `look` names parts or data that `frame` does not have: before a long run."""
    found = survey([frame], unframed(look))
    Styles(look, preset_of(background_for(look, found)), found, 1.0)


def unframed(look: Look) -> list[str]:
    """Parts that the camera need not keep in the picture."""
    return [name for name, style in look.parts.items() if style.kind == "hidden" or not style.framed]


def background_for(look: Look, found: Survey) -> Background:
    """The background: as the look says, or what suits the scene."""
    if look.background != "auto":
        return look.background
    if any(style.kind == "stars" for style in look.parts.values()):
        return "space"
    parts = list(found.parts.values())
    if any_fluid(parts):
        return "studio" if found.flat is None else "night"
    if found.flat is not None:
        return "paper"
    return "studio" if parts and all(isinstance(part, Mesh) for part in parts) else "dusk"


def samples_for(found: Survey) -> int:
    """Samples along each side of a pixel: fewer where points are so many that they smooth each other."""
    return 1 if sum(len(part.position) for part in found.parts.values()) >= MANY else 2
