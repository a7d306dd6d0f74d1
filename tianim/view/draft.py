"""Draft: turns a frame into geometry, by the style of each part, fixed for the whole film.

What the look leaves open is decided once, from the survey: kinds, sizes, colour ranges.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.frame import Frame, Lines, Mesh, Part, Points
from tianim.view import colormap
from tianim.view.backdrop import Preset
from tianim.view.camera import View
from tianim.view.canvas import Blend, Geometry, Spheres, Sticks, Triangles
from tianim.view.look import Look, PartStyle
from tianim.view.raster import FOCAL, PERSPECTIVE, pose_shapes
from tianim.view.shapes import FAR_SHAPES, SHAPES, Shape, forward_of, heading_quaternion
from tianim.view.survey import Survey
from tianim.view.values import CYCLIC, can_color_by, species_of, values_of

Float = NDArray[np.float32]

DART_SPACING = 0.85  # length of a dart over the distance of neighbours
SPHERE_SPACING = 0.9
DART_PIXELS = (5.5, 44.0)  # least and greatest automatic length [pixels of 720 rows]
SPHERE_PIXELS = (1.6, 60.0)
ARROW_PIXELS = (9.0, 44.0)
ARROW_SPACING = 1.15
LINE_PIXELS = (1.6, 7.0)
LINE_SPACING = 0.35  # thickness of a line over the length of its segments
FAR_BELOW = 10.0  # pixels: a shorter dart is drawn as a simpler shape
CROWDED = 40_000  # points from which the least sizes shrink, so that they do not hide each other
STICK_BELOW = 3.2  # pixels: a shorter dart is drawn as a plain stick with smooth edges
MOST_SHAPES = 400_000  # more darts than this are drawn as plain sticks
RARE = 0.02  # a species of a smaller share is drawn larger
RARE_SCALE = 3.0
ROWS = 2 * colormap.ENTRIES  # rows of the colour table of a part: front, back
RANGE_PERCENTILES = (2.0, 98.0)
JUMP = 12.0  # a trail breaks where a point moves this many times the median: it went round a periodic box


@dataclass(frozen=True)
class _Resolved:
    """A style with nothing left open."""

    kind: str
    size: float
    scales: tuple[float, ...]
    first_row: int
    by: str | None
    low: float
    high: float
    log: bool
    categories: int
    trail: int
    opacity: float


class Draft:
    """Makes the geometry of frames; `view` is a typical camera, for sizes in pixels."""

    def __init__(self, look: Look, preset: Preset, survey: Survey, view: View) -> None:
        self._look, self._preset, self._survey = look, preset, survey
        # Metres that a pixel covers at the action, were the picture 720 rows high.
        w = view.distance if view.camera[PERSPECTIVE] > 0.5 else 1.0
        self._pixel = w / float(view.camera[FOCAL]) * look.height / 720.0
        self._tables: list[Float] = []
        unknown = [name for name in look.parts if survey.parts and name not in survey.parts]
        if unknown:
            have = ", ".join(survey.parts) or "none"
            raise SceneError(f"view.parts {unknown[0]!r}: there is no such part; there are {have}")
        self._styles = {name: self._resolve(part) for name, part in survey.parts.items()}
        self._colors = np.concatenate(self._tables) if self._tables else np.zeros((1, 3), np.float32)

    @property
    def trail(self) -> int:
        """Frames before the present one that `geometry` wants to see."""
        return max((style.trail for style in self._styles.values()), default=0)

    def geometry(self, frame: Frame, earlier: Sequence[Frame] = ()) -> Geometry:
        """All that `frame` shows; `earlier` holds the frames before it, oldest first, for trails."""
        spheres: list[Spheres] = []
        meshes: list[Triangles] = []
        sticks: list[Sticks] = []
        blends: list[Blend] = []
        for part in frame.parts:
            style = self._styles.get(part.name) or self._late(part)
            if style.kind == "hidden":
                continue
            if isinstance(part, Mesh):
                meshes.append(self._mesh(part, style))
            elif isinstance(part, Lines):
                self._lines(part, style, sticks, blends)
            else:
                if style.trail and earlier:
                    blends.append(self._trail(part, style, earlier))
                self._points(part, style, frame.time, spheres, meshes, blends)
        return Geometry(self._colors, _joined_spheres(spheres), _joined(meshes), _joined_sticks(sticks), tuple(blends))

    def _late(self, part: Part) -> _Resolved:
        """A part that the survey did not meet: it appeared in a frame between."""
        style = self._styles[part.name] = self._resolve(part)
        self._colors = np.concatenate(self._tables)
        return style

    # --- styles -------------------------------------------------------------------------------

    def _resolve(self, part: Part) -> _Resolved:
        style = self._look.parts.get(part.name, PartStyle())
        kind = self._kind(part, style)
        by, low, high, categories = self._coloring(part, style)
        scales = style.species_scale or self._rare_scales(part)
        first_row = ROWS * len(self._tables)
        self._tables.append(self._table(part, style, by, categories))
        return _Resolved(
            kind, style.size or self._size(part, kind), scales, first_row, by, low, high, style.color.log,
            categories, style.trail, style.opacity,
        )  # fmt: skip

    def _kind(self, part: Part, style: PartStyle) -> str:
        natural = "mesh" if isinstance(part, Mesh) else "lines" if isinstance(part, Lines) else "auto"
        if style.kind == "hidden":
            return "hidden"
        if natural != "auto":
            if style.kind not in ("auto", natural):
                raise SceneError(f"view.parts.{part.name}.kind {style.kind!r}: the part is a {natural}, not points")
            return natural
        if style.kind in ("mesh", "lines"):
            raise SceneError(f"view.parts.{part.name}.kind {style.kind!r}: the part is points")
        if style.kind != "auto":
            return style.kind
        if "velocity" not in part.data and "orientation" not in part.data:
            return "spheres"
        return "arrows" if self._survey.flat is not None else self._preset.darts

    def _size(self, part: Part, kind: str) -> float:
        spacing = self._survey.spacing.get(part.name, 0.0)
        if kind == "lines":
            least, most, share = *LINE_PIXELS, LINE_SPACING
        elif kind in ("spheres", "glow"):
            least, most, share = *SPHERE_PIXELS, SPHERE_SPACING
        elif kind == "arrows":
            least, most, share = *ARROW_PIXELS, ARROW_SPACING
        else:
            least, most, share = *DART_PIXELS, DART_SPACING
        wanted = spacing * share if spacing > 0.0 else 0.4 * most * self._pixel
        if kind != "lines":
            least *= min(1.0, max(0.3, (CROWDED / max(len(part.position), 1)) ** 0.5))
        return float(np.clip(wanted, least * self._pixel, most * self._pixel))

    def _rare_scales(self, part: Part) -> tuple[float, ...]:
        species = species_of(part)
        if species is None:
            return (1.0,)
        counts = np.bincount(np.maximum(species, 0))
        return tuple(RARE_SCALE if 0 < count < RARE * len(species) else 1.0 for count in counts)

    def _coloring(self, part: Part, style: PartStyle) -> tuple[str | None, float, float, int]:
        """What colours the part, the values at the ends of the map, and the number of categories or 0."""
        wanted = style.color.by
        if wanted is not None and wanted.startswith("#"):
            return None, 0.0, 1.0, 0
        if wanted is None:
            species = species_of(part)
            if species is not None and species.min() != species.max():
                wanted = "species"
            elif isinstance(part, Points) and self._preset.by and can_color_by(part, self._preset.by):
                wanted = self._preset.by
            elif style.color.map is not None and can_color_by(part, "speed"):
                wanted = "speed"
            else:
                return None, 0.0, 1.0, 0
        values_of(part, wanted, self._survey.flat)  # names what there is, before any drawing
        palette = style.color.palette or (self._preset.subject if wanted == "species" else None)
        if palette and style.color.map is None:
            return wanted, 0.0, 1.0, len(palette)
        if style.color.range is not None:
            return wanted, *style.color.range, 0
        if wanted == CYCLIC:
            return wanted, 0.0, 1.0, 0
        return wanted, *self._range(part.name, wanted), 0

    def _range(self, name: str, by: str) -> tuple[float, float]:
        """Percentiles of the values of a part over the whole film."""
        found = []
        for frame in self._survey.frames:
            for part in frame.parts:
                if part.name == name and can_color_by(part, by):
                    values = values_of(part, by, self._survey.flat)
                    found.append(values[:: max(1, len(values) // 4000)])
        values = np.concatenate(found) if found else np.zeros(0, np.float32)
        values = values[np.isfinite(values)]
        if not len(values):
            return 0.0, 1.0
        low, high = (float(v) for v in np.percentile(values, RANGE_PERCENTILES))
        # Values that hardly differ are one colour, the middle, not noise stretched over the map.
        least = max(0.02 * abs(high), 1e-9)
        if high - low < least:
            middle = 0.5 * (low + high)
            low, high = middle - 0.5 * least, middle + 0.5 * least
        return low, high

    def _table(self, part: Part, style: PartStyle, by: str | None, categories: int) -> Float:
        """Colours of the front and of the back of a part, (512, 3)."""
        color, preset = style.color, self._preset
        if by is None:
            front = colormap.uniform(color.by or self._plain(part))
        elif categories:
            palette = color.palette or preset.subject
            each = np.stack([colormap.hex_to_linear(c) for c in palette])
            front = each[np.minimum(np.arange(colormap.ENTRIES), len(each) - 1)]
        else:
            front = colormap.table(color.map or ("phase" if by == CYCLIC else preset.map))
        back = front
        if color.back is not None:
            back = colormap.uniform(color.back)
        elif isinstance(part, Mesh) and by is None and color.by is None and self._is_subject(part):
            back = colormap.uniform("#e4dccd")
        return np.concatenate([front, back]).astype(np.float32)

    def _plain(self, part: Part) -> str:
        if isinstance(part, Points) or self._is_subject(part):
            return self._preset.subject[0]
        return self._preset.line if isinstance(part, Lines) else self._preset.body

    def _is_subject(self, part: Part) -> bool:
        """Whether a mesh or lines are what the film is about: there is nothing livelier in it."""
        livelier = Points | Lines if isinstance(part, Mesh) else Points
        return not any(isinstance(other, livelier) for other in self._survey.parts.values())

    def _tones(self, part: Part, style: _Resolved) -> Float:
        """Row of the colour table for each point."""
        n = len(part.position)
        if style.by is None or not can_color_by(part, style.by):
            return np.full(n, style.first_row, np.float32)
        values = values_of(part, style.by, self._survey.flat)
        if style.categories:
            share = np.mod(np.nan_to_num(values), style.categories)
            return (np.floor(share) + style.first_row).astype(np.float32)
        low, high = style.low, style.high
        if style.log:
            tiny = max(1e-4 * abs(high), 1e-30)
            values, low, high = np.log(np.maximum(values, tiny)), np.log(max(low, tiny)), np.log(max(high, 2 * tiny))
        share = np.clip(np.nan_to_num((values - low) / (high - low)), 0.0, 1.0)
        return (share * (colormap.ENTRIES - 1) + 0.5 + style.first_row).astype(np.float32)

    # --- geometry -----------------------------------------------------------------------------

    def _points(
        self, part: Points, style: _Resolved, time: float,
        spheres: list[Spheres], meshes: list[Triangles], blends: list[Blend],
    ) -> None:  # fmt: skip
        keep = np.isfinite(part.position).all(axis=1)
        whole = bool(keep.all())
        position = _f32(part.position if whole else part.position[keep])
        tone, size = self._tones(part, style), self._sizes(part, style)
        if not whole:
            tone, size = tone[keep], size[keep]
        shape = SHAPES.get(style.kind)
        if shape is None:
            if style.kind == "glow" or style.opacity < 1.0:
                opacity = np.full(len(position), style.opacity, np.float32)
                glow = 1.0 if style.kind == "glow" else 0.0
                blends.append(Blend(position, position, 0.5 * size, opacity, tone, glow=glow))
            else:
                spheres.append(Spheres(position, 0.5 * size, tone))
            return
        if style.size < FAR_BELOW * self._pixel:
            shape = FAR_SHAPES.get(style.kind, shape)
        turn = self._turns(part, style, keep, whole)
        small = style.size < STICK_BELOW * self._pixel or len(position) > MOST_SHAPES
        if small or style.opacity < 1.0:
            along = forward_of(turn) * (0.5 * size[:, None])
            opacity = np.full(len(position), style.opacity, np.float32)
            tail, head = _f32(position - along), _f32(position + along)
            blends.append(Blend(tail, head, 0.5 * shape.width * size, opacity, tone, taper=0.4))
        else:
            meshes.append(_posed(shape, position, turn, size, tone, time))

    def _sizes(self, part: Points, style: _Resolved) -> Float:
        size = np.full(len(part.position), style.size, np.float32)
        species = species_of(part)
        if species is not None and any(scale != 1.0 for scale in style.scales):
            size *= np.array(style.scales, np.float32)[species % len(style.scales)]
        return size

    def _turns(self, part: Points, style: _Resolved, keep: NDArray[np.bool_], whole: bool) -> Float:
        """Orientation of each point: its own where it has one, else along its velocity."""
        turn = part.data.get("orientation")
        plan = self._survey.flat
        if turn is not None and turn.shape == (len(part.position), 4) and plan is None:
            own = _f32(turn)
            return own if whole else _f32(own[keep])
        velocity = part.data.get("velocity")
        if velocity is not None and velocity.shape == part.position.shape:
            forward = _f32(velocity)
        elif turn is not None and turn.shape == (len(part.position), 4):
            forward = _f32(forward_of(_f32(turn)))
        else:
            forward = np.zeros((len(part.position), 3), np.float32)
        up = (0.0, 0.0, 1.0) if plan == 2 else (1.0, 0.0, 0.0) if plan == 0 else (0.0, 1.0, 0.0)
        return heading_quaternion(np.nan_to_num(forward if whole else forward[keep]), up)

    def _trail(self, part: Points, style: _Resolved, earlier: Sequence[Frame]) -> Blend:
        """Fading sticks through the places of each point in the frames before."""
        places = [part.position]
        for frame in reversed(earlier[-style.trail :]):
            past = next((p for p in frame.parts if p.name == part.name), None)
            if past is None or len(past.position) != len(part.position):
                break
            places.append(past.position)
        tone, size = self._tones(part, style), self._sizes(part, style)
        tails, heads, opacities, tones, radii = [], [], [], [], []
        for age, (head, tail) in enumerate(zip(places, places[1:], strict=False)):
            step = np.linalg.norm(head - tail, axis=1)
            good = np.isfinite(step)
            middle = float(np.median(step[good])) if good.any() else 0.0
            good &= step <= max(JUMP * middle, 2.0 * style.size)
            fade = 0.55 * style.opacity * (1.0 - age / (style.trail + 1.0)) ** 1.5
            tails.append(tail[good])
            heads.append(head[good])
            opacities.append(np.full(int(good.sum()), fade, np.float32))
            tones.append(tone[good])
            radii.append(0.09 * size[good])
        if not tails:
            nothing = np.zeros((0, 3), np.float32)
            return Blend(nothing, nothing, nothing[:, 0].copy(), nothing[:, 0].copy(), nothing[:, 0].copy())
        glow = 0.8 if style.kind == "glow" else 0.0
        join = [_f32(np.concatenate(rows)) for rows in (tails, heads, radii, opacities, tones)]
        return Blend(*join, joined=True, glow=glow)

    def _lines(self, part: Lines, style: _Resolved, sticks: list[Sticks], blends: list[Blend]) -> None:
        position = _f32(part.position)
        segments = np.ascontiguousarray(part.segments, dtype=np.int32)
        good = np.isfinite(position).all(axis=1)
        if not good.all():
            segments = segments[good[segments].all(axis=1)]
            position = np.nan_to_num(position)
        radius = np.full(len(segments), 0.5 * style.size, np.float32)
        tone = self._tones(part, style)[segments[:, 0]]
        if style.opacity < 1.0:
            opacity = np.full(len(segments), style.opacity, np.float32)
            blends.append(Blend(position[segments[:, 0]], position[segments[:, 1]], radius, opacity, tone, joined=True))
        else:
            sticks.append(Sticks(position, segments, radius, tone))

    def _mesh(self, part: Mesh, style: _Resolved) -> Triangles:
        position = _f32(part.position)
        triangles = np.ascontiguousarray(part.triangles, dtype=np.int32)
        good = np.isfinite(position).all(axis=1)
        if not good.all():
            triangles = triangles[good[triangles].all(axis=1)]
            position = np.nan_to_num(position)
        normal = vertex_normals(position, triangles)
        return Triangles(position, normal, triangles, self._tones(part, style), np.ones(len(position), np.float32))


def vertex_normals(position: Float, triangles: NDArray[np.int32]) -> Float:
    """Unit normals (n, 3), each the mean of its triangles by area; zero where there are none."""
    a, b, c = (position[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    out = np.empty_like(position)
    for axis in range(3):
        weights = np.repeat(across[:, axis], 3)
        out[:, axis] = np.bincount(triangles.ravel(), weights=weights, minlength=len(position))
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return _f32(out / np.maximum(length, 1e-30))


def _posed(shape: Shape, position: Float, turn: Float, size: Float, tone: Float, time: float) -> Triangles:
    """Shapes at points as one mesh of flat triangles."""
    n, v = len(position), len(shape.vertices)
    vertices = np.empty((n * v, 3), np.float32)
    if n:
        phase = 2 * np.pi * shape.beat * time
        pose_shapes(vertices, position, turn, size, shape.vertices, shape.motion, phase)
    first = np.arange(n, dtype=np.int32)[:, None, None] * v
    triangles = (shape.triangles[None] + first).reshape(-1, 3)
    return Triangles(
        vertices, np.zeros((n * v, 3), np.float32), triangles, np.repeat(tone, v), np.tile(shape.tint, n)
    )


def _f32(values: NDArray) -> Float:
    return np.ascontiguousarray(values, dtype=np.float32)


def _joined_spheres(parts: Sequence[Spheres]) -> Spheres:
    if len(parts) <= 1:
        return parts[0] if parts else Spheres()
    columns = zip(*((p.position, p.radius, p.tone) for p in parts), strict=True)
    return Spheres(*(np.concatenate(column) for column in columns))


def _joined(parts: Sequence[Triangles]) -> Triangles:
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
    rest = zip(*((p.position, p.radius, p.tone) for p in parts), strict=True)
    position, radius, tone = (np.concatenate(column) for column in rest)
    return Sticks(position, segments, radius, tone)
