"""Styles: what each part looks like, with nothing left open, fixed for the whole film.

What the look leaves out is chosen from the survey: kinds, sizes, colour ranges.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tianim.errors import SceneError
from tianim.frame import Lines, Mesh, Part, Points
from tianim.view import colormap
from tianim.view.backdrop import Preset, is_dark
from tianim.view.look import ColorBy, Look, PartStyle
from tianim.view.material import Substance, substance, tint_of
from tianim.view.sizes import automatic_size
from tianim.view.survey import Survey
from tianim.view.values import CYCLIC, can_color_by, values_of
from tianim.view.wet import EDGE_OPACITY, FOAM_OPACITY, is_fluid, is_foam, is_wet, torn

Float = NDArray[np.float32]

RARE = 0.02  # a part of a smaller share of all points is a hunter or a leader: it must be seen
RARE_SCALE = 3.0  # its size over that of the most common points
ROWS = 2 * colormap.ENTRIES  # rows of the colour table of a part: front, back
RANGE_PERCENTILES = (2.0, 98.0)
FOAM = "#ffffff"
LINING = "#e4dccd"  # back of a mesh that is the subject


@dataclass(frozen=True)
class Style:
    """A style with nothing left open.

    size       length of a dart, diameter of a sphere, thickness of a line [m]
    first_row  of the part in the colour table
    by         data that colours the part, from `low` to `high`; None: one colour
    palette    number of colours, where each whole number has its own; 0: a map
    substance  what a mesh is made of that light goes through
    beads      diameter of balls at the points of lines [m]; 0: none
    """

    kind: str
    size: float
    first_row: int
    by: str | None
    low: float
    high: float
    log: bool
    palette: int
    trail: int
    opacity: float
    substance: Substance | None = None
    beads: float = 0.0


@dataclass(frozen=True)
class _Coloring:
    by: str | None = None
    low: float = 0.0
    high: float = 1.0
    palette: int = 0


class Styles:
    """The styles of all parts of a film.

    `pixel` is what a pixel of 720 rows covers at the action, `radius` that of the action [m].
    """

    def __init__(self, look: Look, preset: Preset, survey: Survey, pixel: float, radius: float = 1.0) -> None:
        self._look, self._preset, self._survey, self.pixel = look, preset, survey, pixel
        self._radius = radius
        self._tables: list[Float] = []
        unknown = [name for name in look.parts if survey.parts and name not in survey.parts]
        if unknown:
            have = ", ".join(survey.parts)
            raise SceneError(f"view.parts {unknown[0]!r}: there is no such part; there are {have}")
        self._wet = is_wet(look, survey.parts)
        points = {name: len(p.position) for name, p in survey.parts.items() if isinstance(p, Points)}
        self._most = max(points, key=points.__getitem__) if points else None
        self._rare = {
            name
            for name, count in points.items()
            if count < RARE * sum(points.values())
            and not (is_fluid(survey.parts[name]) or is_foam(survey.parts[name]))
        }
        self._order = sorted(points, key=lambda name: name != self._most)  # the most common first
        self._styles = {name: self._resolve(part) for name, part in survey.parts.items()}

    @property
    def trail(self) -> int:
        """Length of the longest trail [frames]."""
        return max((style.trail for style in self._styles.values()), default=0)

    @property
    def colors(self) -> Float:
        """The colour tables of all parts, (rows, 3) linear light."""
        return np.concatenate(self._tables) if self._tables else np.zeros((1, 3), np.float32)

    def of(self, part: Part) -> Style:
        """The style of `part`; one that no surveyed frame had gets its style now."""
        if part.name not in self._styles:
            self._styles[part.name] = self._resolve(part)
        return self._styles[part.name]

    def tones(self, part: Part, style: Style) -> Float:
        """Row of the colour table for each point, shape (n,): in the middle of the row, for it is cut off.

        Blended over a triangle, a whole number would fall to the row below it here and there.
        """
        if style.by is None or not can_color_by(part, style.by):
            return np.full(len(part.position), style.first_row + 0.5, np.float32)
        values = values_of(part, style.by, self._survey.flat)
        if style.palette:
            place = np.floor(np.mod(np.nan_to_num(values), style.palette))
            return (place + 0.5 + style.first_row).astype(np.float32)
        low, high = style.low, style.high
        if style.log:
            tiny = max(1e-4 * abs(high), 1e-30)
            values, low, high = (
                np.log(np.maximum(values, tiny)),
                np.log(max(low, tiny)),
                np.log(max(high, 2 * tiny)),
            )
        share = np.clip(np.nan_to_num((values - low) / (high - low)), 0.0, 1.0)
        white = torn(part) if self._map(part, style.by) == "water" else None
        if white is not None:
            share = np.maximum(share, white)
        return (share * (colormap.ENTRIES - 1) + 0.5 + style.first_row).astype(np.float32)

    def _resolve(self, part: Part) -> Style:
        given = self._look.parts.get(part.name, PartStyle())
        kind = self._kind(part, given)
        coloring = self._coloring(part, given.color)
        first_row = ROWS * len(self._tables)
        self._tables.append(self._table(part, given.color, coloring))
        return Style(
            kind, given.size or self._size(part, kind), first_row, coloring.by, coloring.low, coloring.high,
            given.color.log, coloring.palette, given.trail, self._opacity(part, given),
            self._substance(part, given), self._beads(part, given),
        )  # fmt: skip

    def _kind(self, part: Part, given: PartStyle) -> str:
        if given.kind == "hidden":
            return "hidden"
        if not isinstance(part, Points):
            own = "mesh" if isinstance(part, Mesh) else "lines"
            if given.kind not in ("auto", own):
                raise SceneError(f"view.parts.{part.name}.kind {given.kind!r}: the part is {own}, not points")
            return "edges" if own == "lines" and self._wet else own
        if given.kind in ("mesh", "lines"):
            raise SceneError(f"view.parts.{part.name}.kind {given.kind!r}: the part is points")
        if given.kind != "auto":
            return given.kind
        if is_foam(part):
            return "foam"
        if is_fluid(part) or ("velocity" not in part.data and "orientation" not in part.data):
            return "spheres"
        return "arrows" if self._survey.flat is not None else self._preset.darts

    def _is_foam(self, part: Part) -> bool:
        return self._kind(part, self._look.parts.get(part.name, PartStyle())) == "foam"

    def _substance(self, part: Part, given: PartStyle) -> Substance | None:
        """What a mesh is made of; None for all that light does not go through."""
        if given.material is None:
            return None
        if not isinstance(part, Mesh):
            raise SceneError(f"view.parts.{part.name}.material: only a mesh has one; the part is no mesh")
        return substance(given.material, self._radius, is_dark(self._preset))

    def _beads(self, part: Part, given: PartStyle) -> float:
        if given.beads is not None and not isinstance(part, Lines):
            raise SceneError(f"view.parts.{part.name}.beads: only lines have them; the part is no lines")
        return given.beads or 0.0

    def _size(self, part: Part, kind: str) -> float:
        """The automatic size [m]."""
        if part.name in self._rare and self._most is not None:
            common = self._survey.parts[self._most]
            given = self._look.parts.get(self._most, PartStyle())
            return RARE_SCALE * (given.size or self._size(common, self._kind(common, given)))
        return automatic_size(part, kind, self._survey, self.pixel)

    def _opacity(self, part: Part, given: PartStyle) -> float:
        """The opacity: edges of a tank, and foam, let things through unless the look says otherwise."""
        if "opacity" in given.model_fields_set:
            return given.opacity
        if isinstance(part, Lines) and self._wet:
            return EDGE_OPACITY
        return FOAM_OPACITY if self._kind(part, given) == "foam" else given.opacity

    def _map(self, part: Part, by: str | None) -> str:
        """Name of the map that colours a part."""
        given = self._look.parts.get(part.name, PartStyle()).color.map
        if given is not None:
            return given
        if by == CYCLIC:
            return "phase"
        return "water" if is_fluid(part) else self._preset.map

    def _coloring(self, part: Part, color: ColorBy) -> _Coloring:
        """What colours the part, and the values at the ends of the map."""
        by = color.by
        if by is not None and by.startswith("#"):
            return _Coloring()
        if by is None:
            by = self._usual(part, color)
            if by is None:
                return _Coloring()
        values_of(part, by, self._survey.flat)  # names what there is, before any drawing
        if color.palette is not None:
            return _Coloring(by, palette=len(color.palette))
        if color.range is not None:
            return _Coloring(by, *color.range)
        return _Coloring(by) if by == CYCLIC else _Coloring(by, *_range_of(self._survey, part.name, by))

    def _usual(self, part: Part, color: ColorBy) -> str | None:
        """What colours a part of which the look does not say: hunters keep their one colour."""
        if is_fluid(part):
            return "speed" if can_color_by(part, "speed") else None
        if self._is_foam(part):
            return None
        wanted = (
            self._preset.by if color.map is None and color.palette is None else self._preset.by or "speed"
        )
        if wanted is None or not isinstance(part, Points) or part.name in self._rare:
            return None
        return wanted if can_color_by(part, wanted) else None

    def _table(self, part: Part, color: ColorBy, coloring: _Coloring) -> Float:
        """Colours of the front and of the back of a part, (512, 3)."""
        if coloring.by is None:
            front = colormap.uniform(color.by or self._plain(part))
        elif color.palette is not None:
            front = colormap.palette(color.palette)
        else:
            front = colormap.table(self._map(part, coloring.by))
        back = front
        if color.back is not None:
            back = colormap.uniform(color.back)
        elif isinstance(part, Mesh) and coloring.by is None and color.by is None and self._is_subject(part):
            back = colormap.uniform(LINING)
        return np.concatenate([front, back]).astype(np.float32)

    def _plain(self, part: Part) -> str:
        """The one colour of a part of which the look does not say."""
        colors: Sequence[str] = self._preset.subject
        material = self._look.parts.get(part.name, PartStyle()).material
        if material is not None:
            return tint_of(material)
        if self._is_foam(part):
            return FOAM
        if self._wet and isinstance(part, Lines):
            return self._preset.line
        if isinstance(part, Points):
            place = self._order.index(part.name) if part.name in self._order else 0
            return colors[place % len(colors)]
        if self._is_subject(part):
            return colors[0]
        return self._preset.line if isinstance(part, Lines) else self._preset.body

    def _is_subject(self, part: Part) -> bool:
        """Whether a mesh or lines are what the film is about: there is nothing livelier in it."""
        livelier = Points | Lines if isinstance(part, Mesh) else Points
        return not any(isinstance(other, livelier) for other in self._survey.parts.values())


def _range_of(survey: Survey, name: str, by: str) -> tuple[float, float]:
    """Percentiles of the values of a part over the whole film."""
    parts = [part for frame in survey.frames for part in frame.parts if part.name == name]
    found = [values_of(part, by, survey.flat) for part in parts if can_color_by(part, by)]
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
