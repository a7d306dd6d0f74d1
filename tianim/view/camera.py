"""The camera: frames the action without jitter, goes slowly round it, looks straight down on a plan.

For each surveyed frame the centre of the action is the middle of its 2 to 98 % bounds as the camera
sees them. Centres and distances are smoothed over seconds and joined by a cubic spline.
"""

from dataclasses import dataclass
from math import cos, radians, sin, tan

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from tianim.view.layout import CAMERA_SIZE, FOCAL, HEIGHT, NEAR, PERSPECTIVE, WIDTH
from tianim.view.look import CameraLook
from tianim.view.survey import Survey
from tianim.view.wet import FLUID_BOUNDS

Float = NDArray[np.float32]
Vector = NDArray[np.float64]

ROBUST = (2.0, 98.0)  # percentiles that bound loose points
WHOLE = (0.0, 100.0)  # and what hangs together
FILL = 0.62  # share of the height that the action fills
FILL_PLAN = 0.86
WIDEST = 0.80  # share of the width that the action may fill
CENTER_SECONDS = 1.6  # smoothing of the centre
DISTANCE_SECONDS = 2.2  # smoothing of the distance
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class View:
    """One camera: its array (see layout), distance to the action [m] and radius of the action [m]."""

    camera: Float
    distance: float
    radius: float


def camera_array(
    eye: Vector,
    target: Vector,
    width: int,
    height: int,
    half_height: float,
    perspective: bool,
    up: Vector = UP,
) -> Float:
    """The array that the kernels read.

    `half_height` is the tangent of half the angle of view, or half the height shown [m] when orthographic.
    """
    forward = target - eye
    distance = float(np.linalg.norm(forward))
    if distance < 1e-12:  # standing on the target: any direction will do
        forward, distance = np.array([0.0, 0.0, -1e-12]), 1e-12
    forward = forward / distance
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # looking along `up`: any level direction will do
        right = np.cross(forward, np.array([0.0, 0.0, -1.0]))
    right /= np.linalg.norm(right)
    out = np.zeros(CAMERA_SIZE, np.float32)
    out[0:3], out[3:6], out[6:9], out[9:12] = eye, right, np.cross(right, forward), forward
    out[FOCAL] = 0.5 * height / half_height
    out[PERSPECTIVE] = perspective
    out[WIDTH], out[HEIGHT] = width, height
    out[NEAR] = max(1e-3 * distance, 1e-12)
    return out


def _toward(azimuth: float, elevation: float) -> Vector:
    """Unit vector from the action to the camera; angles in degrees."""
    a, e = radians(azimuth), radians(elevation)
    return np.array([sin(a) * cos(e), sin(e), cos(a) * cos(e)])


def _axes(back: Vector, up: Vector) -> Vector:
    """Rows right, up, back of a camera that stands in direction `back`."""
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Stand:
    """Where the camera stands where the look leaves it open: direction [degrees], height filled."""

    azimuth: float
    elevation: float
    fill: float = FILL


class CameraPath:
    """Where the camera is at each frame of a film; `girth` is the largest radius of an item [m]."""

    def __init__(
        self, look: CameraLook, survey: Survey, width: int, height: int, stand: Stand, girth: float = 0.0
    ) -> None:
        self._look, self._width, self._height, self._girth = look, width, height, girth
        self._azimuth = stand.azimuth if look.azimuth is None else look.azimuth
        self._usual_elevation = stand.elevation
        self._count = int(survey.indices[-1]) + 1 if len(survey.indices) else 1
        self._plan = survey.flat if look.position is None else None
        if look.elevation is not None or look.azimuth is not None:
            self._plan = None
        flat_picture = look.projection == "auto" and self._plan is not None
        self.perspective = not flat_picture and look.projection != "orthographic"
        self.fill = (
            look.fill if look.fill is not None else (FILL_PLAN if self._plan is not None else stand.fill)
        )
        self._half = tan(radians(look.field_of_view) / 2)
        self._fit(survey)

    def at(self, index: int, time: float) -> View:
        """The view of frame `index` at `time` [s]."""
        center, distance = self._center(index), float(self._distance(index))
        back, up = self._direction(index, time)
        look = self._look.at(time)
        target = np.array(look.target) if look.target is not None else center
        if look.position is not None:
            eye = np.array(look.position)
            distance = max(float(np.linalg.norm(center - eye)), 1e-9)
        else:
            eye = target + back * distance
        half = self._half
        if not self.perspective:
            half = distance * self._half
            eye = eye + (eye - target) * 4.0  # stand back: nothing must be behind the camera
            distance *= 5.0
        camera = camera_array(eye, target, self._width, self._height, half, self.perspective, up)
        return View(camera, distance, self._radius)

    def _direction(self, index: float, time: float) -> tuple[Vector, Vector]:
        """Direction towards the camera, and what is up in the picture."""
        if self._plan is not None:
            back = np.zeros(3)
            back[self._plan] = 1.0
            return back, (np.array([0.0, 0.0, -1.0]) if self._plan == 1 else UP)
        share = index / max(self._count - 1, 1) - 0.5
        elevation = self._look.at(time).elevation
        if elevation is None:
            elevation = self._usual_elevation
        return _toward(self._azimuth + self._look.orbit * share, elevation), UP

    def _fit(self, survey: Survey) -> None:
        """Fit centre and distance to every surveyed frame, and smooth both."""
        self._bounds = ROBUST if survey.loose and self._plan is None else WHOLE
        if survey.loose and survey.fluid and self._plan is None:
            self._bounds = FLUID_BOUNDS
        action = list(survey.action)
        everything = survey.everything
        if not len(everything):
            everything = np.zeros((1, 3), np.float32)
        action = [points if len(points) else everything for points in action] or [everything]
        if self._plan is not None or survey.fluid:
            action = [everything] * len(action)  # a plan, and a vessel, stand still
        indices = survey.indices if len(survey.indices) else np.zeros(1)
        frames_apart = (self._count - 1) / max(len(indices) - 1, 1)
        seconds = float(np.ptp(survey.times)) / max(len(indices) - 1, 1) if len(survey.times) else 1.0
        times = survey.times if len(survey.times) else np.zeros(1)
        stands = [
            _axes(*self._direction(float(index), float(time)))
            for index, time in zip(indices, times, strict=True)
        ]
        centers = [self._middle(points, axes) for points, axes in zip(action, stands, strict=True)]
        center = _smooth(np.array(centers, np.float64), CENTER_SECONDS / max(seconds, 1e-9))
        wide = [self._needed(p, axes, c) for p, axes, c in zip(action, stands, center, strict=True)]
        sigma = DISTANCE_SECONDS / max(seconds, 1e-9)
        reach = maximum_filter1d(np.array(wide), size=2 * round(min(sigma, len(wide))) + 1, mode="nearest")
        distance = _smooth(reach[:, None], sigma, steady=True)[:, 0]
        self._radius = float(np.median([_radius(p, c) for p, c in zip(action, center, strict=True)]))
        places = frames_apart * np.arange(len(indices), dtype=np.float64)
        self._center, self._distance = _spline(places, center), _spline(places, distance)

    def _middle(self, points: Float, axes: Vector) -> Vector:
        """World point in the middle of the robust bounds along the camera's axes."""
        seen = points.astype(np.float64) @ axes.T
        return np.percentile(seen, self._bounds, axis=0).mean(axis=0) @ axes

    def _needed(self, points: Float, axes: Vector, center: Vector) -> float:
        """Distance [m] from which the action fills its share of the picture."""
        seen = (points.astype(np.float64) - center) @ axes.T
        tall, wide = self._half * self.fill, self._half * self._width / self._height * max(WIDEST, self.fill)
        depth = seen[:, 2] if self.perspective else 0.0
        up, aside = np.abs(seen[:, 1]) + self._girth, np.abs(seen[:, 0]) + self._girth
        size = float(np.percentile(np.maximum(up / tall, aside / wide) + depth, self._bounds[1]))
        return max(size, 1e-6 + 1e-3 * float(np.abs(center).max()), 0.5 if len(points) < 2 else 0.0)


def _radius(points: Float, center: Vector) -> float:
    away = np.linalg.norm(points - center, axis=1)
    return max(float(np.percentile(away, ROBUST[1])), 1e-6)


def _smooth(values: Vector, sigma: float, steady: bool = False) -> Vector:
    """Gaussian means over `sigma` samples of rows (n, k).

    What moves on at the ends is taken to move on beyond them, or to stand still there (`steady`).
    """
    count = len(values)
    if count < 3:
        return values
    sigma = min(sigma, count / 3)
    beyond = min(count - 1, int(np.ceil(4 * sigma)))
    padding = ((beyond, beyond), (0, 0))
    padded = (
        np.pad(values, padding, "edge") if steady else np.pad(values, padding, "reflect", reflect_type="odd")
    )
    return gaussian_filter1d(padded, sigma, axis=0, mode="nearest")[beyond : beyond + count]


def _spline(places: Vector, values: Vector) -> CubicSpline:
    if len(places) == 1:
        places, values = np.array([0.0, 1.0]), np.concatenate([values, values])
    return CubicSpline(places, values)
