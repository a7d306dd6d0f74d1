"""Draft: turns the parts of a frame into geometry, each in its style."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tianim.frame import Frame, Lines, Mesh, Part, Points
from tianim.view.canvas import Blend, Geometry, Spheres, Sticks, Triangles
from tianim.view.liquid import Liquid, mesh_normals
from tianim.view.material import Substance
from tianim.view.raster import pose_shapes
from tianim.view.shapes import FAR_SHAPES, NEAR_SHAPES, SHAPES, Shape, forward_of, heading_quaternion
from tianim.view.starlight import Stars, mean_mass, stars_of
from tianim.view.styles import Style, Styles
from tianim.view.tank import laid_on_walls
from tianim.view.wet import pieces

Float = NDArray[np.float32]

STICK_BELOW = 3.2  # pixels: a shorter dart is drawn as a plain stick with smooth edges
FAR_BELOW = 10.0  # pixels: a shorter one as a simpler shape
NEAR_ABOVE = 40.0  # pixels: a longer one as a finer shape
MOST_SHAPES = 400_000  # more darts than this are drawn as plain sticks
TRAIL_OPACITY = 0.5
TRAIL_WIDTH = 0.12  # of a trail at its head, over the size of the point
CURVE_OPACITY = 0.85  # what a bead leaves behind is a curve to be read: it hardly thins
FOAM_HEART = 0.5  # diameter of the dense middle of foam over the whole
JUMP = 12.0  # a trail breaks where a point moves this many times the median: it went round a periodic box


class Draft:
    """Makes the geometry of frames; `flat` is the axis along which the scene is flat, or None.

    `matt`: draw liquids as plain meshes of their colour.
    """

    def __init__(self, styles: Styles, flat: int | None) -> None:
        self._styles, self._flat = styles, flat
        self.matt = False

    @property
    def trail(self) -> int:
        """Frames before the present one that `geometry` wants to see."""
        return self._styles.trail

    def geometry(self, frame: Frame, earlier: Sequence[Frame] = ()) -> Geometry:
        """All that `frame` shows; `earlier` holds the frames before it, oldest first, for trails."""
        spheres: list[Spheres] = []
        meshes: list[Triangles] = []
        sticks: list[Sticks] = []
        blends: list[Blend] = []
        liquids: list[Liquid] = []
        for part in frame.parts:
            style = self._styles.of(part)
            if style.kind == "hidden" or not len(part.position):
                continue
            if style.trail and earlier and (isinstance(part, Points) or style.beads):
                blends += self._trail(part, style, earlier)
            if style.beads:
                spheres.append(_beads(part, style, self._styles.tones(part, style)))
            if style.kind == "stars":
                continue
            if isinstance(part, Mesh) and style.substance is not None and not self.matt:
                liquids.append(_liquid(part, style.substance, frame))
                continue
            drawn = self._draw(part, style, frame.time)
            spheres += [drawn] if isinstance(drawn, Spheres) else []
            meshes += [drawn] if isinstance(drawn, Triangles) else []
            sticks += [drawn] if isinstance(drawn, Sticks) else []
            blends += [drawn] if isinstance(drawn, Blend) else []
        return Geometry(
            self._styles.colors,
            _joined_spheres(spheres),
            _joined_meshes(meshes),
            _joined_sticks(sticks),
            tuple(blends),
            tuple(liquids),
        )

    def stars(self, frame: Frame) -> list[Stars]:
        """All points of `frame` that are drawn as stars, of all their parts by one measure of mass."""
        styled = [(part, self._styles.of(part)) for part in frame.parts if isinstance(part, Points)]
        shown = [(part, style) for part, style in styled if style.kind == "stars"]
        mean = mean_mass(part for part, _ in shown)
        return [stars_of(part, self._styles.tones(part, style), style.opacity, mean) for part, style in shown]

    @property
    def colors(self) -> Float:
        """The colour tables that tones point into, (rows, 3) linear light."""
        return self._styles.colors

    def _draw(
        self, part: Points | Mesh | Lines, style: Style, time: float
    ) -> Spheres | Triangles | Sticks | Blend:
        tone = self._styles.tones(part, style)
        if isinstance(part, Mesh):
            return _mesh(part, tone)
        if isinstance(part, Lines):
            return _lines(part, style, tone)
        good = _finite_rows(part.position)
        keep = slice(None) if good.all() else good  # a slice makes no copies
        position, tone = _f32(part.position[keep]), tone[keep]
        size = np.full(len(position), style.size, np.float32)
        if style.kind not in SHAPES:
            return _balls(position, size, tone, style)
        turn = self._turns(part, keep)
        shape, pixels = SHAPES[style.kind], style.size / self._styles.pixel
        if pixels < STICK_BELOW or len(position) > MOST_SHAPES or style.opacity < 1.0:
            along = forward_of(turn) * (0.5 * size[:, None])
            opacity = np.full(len(position), style.opacity, np.float32)
            radius = 0.5 * shape.width * size
            return Blend(_f32(position - along), _f32(position + along), radius, opacity, tone, taper=0.4)
        if pixels < FAR_BELOW:
            shape = FAR_SHAPES.get(style.kind, shape)
        elif pixels > NEAR_ABOVE:
            shape = NEAR_SHAPES.get(style.kind, shape)
        return _posed(shape, position, turn, size, tone, time)

    def _turns(self, part: Points, keep: NDArray[np.bool_] | slice) -> Float:
        """Orientation of each point: its own where it has one, else along its velocity; level in a plan."""
        turn, velocity = part.data.get("orientation"), part.data.get("velocity")
        if turn is not None and turn.shape == (len(part.position), 4):
            own = _f32(turn[keep])
            if self._flat is None:
                return own
            forward = _f32(forward_of(own))
        else:
            forward = np.zeros_like(part.position[keep])
        if velocity is not None and velocity.shape == part.position.shape:
            forward = _f32(velocity[keep])
        axis = 1 if self._flat is None else self._flat
        return heading_quaternion(
            np.nan_to_num(forward), (float(axis == 0), float(axis == 1), float(axis == 2))
        )

    def _trail(self, part: Part, style: Style, earlier: Sequence[Frame]) -> list[Blend]:
        """Fading, thinning sticks through the places of each point in the frames before, newest first."""
        size = style.beads or style.size
        tone, blends = self._styles.tones(part, style), []
        head = _f32(part.position)
        for age, frame in enumerate(reversed(earlier[-style.trail :])):
            past = next((p for p in frame.parts if p.name == part.name), None)
            if past is None or len(past.position) != len(head):
                break
            tail = _f32(past.position)
            step = np.linalg.norm(head - tail, axis=1)
            known = np.isfinite(step)
            middle = float(np.median(step[known])) if known.any() else 0.0
            good = known & (step <= max(JUMP * middle, 2.0 * size))
            left = 1.0 - age / (style.trail + 1.0)
            count = int(good.sum())
            fade, width = TRAIL_OPACITY * left**1.5, TRAIL_WIDTH * left
            if style.beads:
                fade, width = CURVE_OPACITY * left**0.5, TRAIL_WIDTH * (0.5 + 0.5 * left)
            opacity = np.full(count, fade * style.opacity, np.float32)
            radius = np.full(count, 0.5 * width * size, np.float32)
            glow = 0.8 if style.kind == "glow" else 0.0
            blends.append(Blend(tail[good], head[good], radius, opacity, tone[good], joined=True, glow=glow))
            head = tail
        return blends


def nearest_first(geometry: Geometry, camera: Float) -> Geometry:
    """The geometry with its spheres from near to far: those in a body are then soon found to be hidden."""
    spheres = geometry.spheres
    order = np.argsort((spheres.position - camera[:3]) @ camera[9:12], kind="stable")
    sorted_ = Spheres(_f32(spheres.position[order]), spheres.radius[order], spheres.tone[order])
    return replace(geometry, spheres=sorted_)


def _beads(part: Part, style: Style, tone: Float) -> Spheres:
    good = _finite_rows(part.position)
    return Spheres(
        _f32(part.position[good]), np.full(int(good.sum()), 0.5 * style.beads, np.float32), tone[good]
    )


def _balls(position: Float, size: Float, tone: Float, style: Style) -> Spheres | Blend:
    if style.kind not in ("glow", "foam") and style.opacity == 1.0:
        return Spheres(position, 0.5 * size, tone)
    opacity = np.full(len(position), style.opacity, np.float32)
    if style.kind == "foam":  # a disc in a disc: a soft edge
        position, tone = np.concatenate([position, position]), np.concatenate([tone, tone])
        opacity = np.full(len(position), 1.0 - (1.0 - style.opacity) ** 0.5, np.float32)
        size = np.concatenate([size, FOAM_HEART * size])
    return Blend(position, position, 0.5 * size, opacity, tone, glow=1.0 if style.kind == "glow" else 0.0)


def _lines(part: Lines, style: Style, tone: Float) -> Sticks | Blend:
    position, segments = _finite_parts(part.position, part.segments)
    radius = np.full(len(segments), 0.5 * style.size, np.float32)
    tone = tone[segments[:, 0]]
    if style.opacity == 1.0:
        return Sticks(position, segments, radius, tone)
    if style.kind != "edges":
        opacity = np.full(len(segments), style.opacity, np.float32)
        return Blend(position[segments[:, 0]], position[segments[:, 1]], radius, opacity, tone, joined=True)
    start, end = pieces(position[segments[:, 0]], position[segments[:, 1]])
    times = len(start) // max(len(segments), 1)
    radius, tone = np.tile(radius, times), np.tile(tone, times)
    opacity = np.full(len(start), style.opacity, np.float32)
    return Blend(start, end, radius, opacity, tone, joined=True)


def _mesh(part: Mesh, tone: Float) -> Triangles:
    position, triangles = _finite_parts(part.position, part.triangles)
    normal = vertex_normals(position, triangles)
    return Triangles(position, normal, triangles, tone, np.ones(len(position), np.float32))


def _liquid(part: Mesh, made_of: Substance, frame: Frame) -> Liquid:
    """The mesh, laid on the walls of a tank, with its own normals where it has them and they still hold."""
    position, triangles = _finite_parts(part.position, part.triangles)
    fitted = laid_on_walls(position, frame)
    normal = np.empty_like(position)
    mesh_normals(normal, fitted, triangles)
    given = part.data.get("normal")
    if given is not None and given.shape == position.shape:
        holds = np.isfinite(given).all(axis=1) & (fitted == position).all(axis=1)
        normal[holds] = given[holds]
    return Liquid(fitted, normal, triangles, made_of)


def _finite_parts(position: Float, indices: NDArray[np.int32]) -> tuple[Float, NDArray[np.int32]]:
    """Positions without NaN, and the segments or triangles that had none."""
    good = _finite_rows(position)
    indices = np.ascontiguousarray(indices, dtype=np.int32)
    if good.all():
        return _f32(position), indices
    whole = good[indices].all(axis=1)
    return _f32(np.where(good[:, None], position, 0.0)), np.ascontiguousarray(indices[whole])


def vertex_normals(position: Float, triangles: NDArray[np.int32]) -> Float:
    """Unit normals (n, 3), each the mean of its triangles by their angle there; zero where there are none.

    By angle, not by area: else the corners of a cube lean to the faces that have two triangles there.
    """
    corners = position[triangles]
    ahead = _unit(np.roll(corners, -1, axis=1) - corners)
    behind = -np.roll(ahead, 1, axis=1)
    angle = np.arccos(np.clip(np.einsum("mkc,mkc->mk", ahead, behind), -1.0, 1.0))
    flat = _unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    out = np.empty_like(position)
    for axis in range(3):
        weights = (angle * flat[:, axis : axis + 1]).ravel()
        out[:, axis] = np.bincount(triangles.ravel(), weights=weights, minlength=len(position))
    return _f32(_unit(out))


def _unit(vectors: NDArray) -> NDArray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def _posed(shape: Shape, position: Float, turn: Float, size: Float, tone: Float, time: float) -> Triangles:
    """The shape at every point, as one mesh."""
    n, v = len(position), len(shape.vertices)
    vertices, normals = np.empty((n * v, 3), np.float32), np.zeros((n * v, 3), np.float32)
    pose_shapes(vertices, position, turn, size, shape.vertices, shape.motion, 2 * np.pi * shape.beat * time)
    if shape.normals is not None:
        nowhere, one = np.zeros_like(position), np.ones_like(size)
        pose_shapes(normals, nowhere, turn, one, shape.normals, np.zeros_like(shape.motion), 0.0)
    first = np.arange(n, dtype=np.int32)[:, None, None] * v
    triangles = (shape.triangles[None] + first).reshape(-1, 3)
    return Triangles(vertices, normals, triangles, np.repeat(tone, v), np.tile(shape.tint, n))


def _finite_rows(position: Float) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(position).all(axis=1))


def _f32(values: NDArray) -> Float:
    return np.ascontiguousarray(values, dtype=np.float32)


def _joined_spheres(parts: Sequence[Spheres]) -> Spheres:
    if len(parts) <= 1:
        return parts[0] if parts else Spheres()
    columns = zip(*((p.position, p.radius, p.tone) for p in parts), strict=True)
    return Spheres(*(np.concatenate(column) for column in columns))


def _joined_meshes(parts: Sequence[Triangles]) -> Triangles:
    if len(parts) <= 1:
        return parts[0] if parts else Triangles()
    first = np.cumsum([0] + [len(p.position) for p in parts])
    triangles = np.concatenate([p.triangles + np.int32(f) for p, f in zip(parts, first, strict=False)])
    rest = zip(*((p.position, p.normal, p.tone, p.tint) for p in parts), strict=True)
    position, normal, tone, tint = (np.concatenate(column) for column in rest)
    return Triangles(position, normal, triangles, tone, tint)


def _joined_sticks(parts: Sequence[Sticks]) -> Sticks:
    if len(parts) <= 1:
        return parts[0] if parts else Sticks()
    first = np.cumsum([0] + [len(p.position) for p in parts])
    segments = np.concatenate([p.segments + np.int32(f) for p, f in zip(parts, first, strict=False)])
    position = np.concatenate([p.position for p in parts])
    radius, tone = np.concatenate([p.radius for p in parts]), np.concatenate([p.tone for p in parts])
    return Sticks(position, segments, radius, tone)
