"""USD: the whole run as one stage, `scene.usdc`, which Blender, Houdini and Maya open as it is.

Point clouds become UsdGeomPoints with velocities, ids and widths, meshes UsdGeomMesh, lines
linear UsdGeomBasisCurves; other data are primvars. Time codes are frame numbers, `fps` of them
a second; up axis and metres a unit are the files'. Numbers that cannot be blended (ids, faces)
have a sample only where they change.

Segments that follow each other are joined into one curve, so hair comes as strands; segments
with data of their own stay curves of two points. `primvars:point` tells each curve point's
index in the part; points that no segment uses are left out.
"""

import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Tf, Usd, UsdGeom, Vt

from tianim.export.axes import is_quaternion, is_vector
from tianim.export.files import whole_folder
from tianim.export.formats import RunInfo
from tianim.export.parts import cell_data_of, kind_of
from tianim.frame import Array, Frame, Int, Lines, Mesh, Part

FILE_NAME = "scene.usdc"
# Bytes of samples that are held before they are written out.
HELD_BYTES = 128 << 20
# Width of points and lines that have no radius, in parts of the scene's size: thin, but seen.
POINT_WIDTH, LINE_WIDTH = 0.3, 0.002
Names = Sdf.ValueTypeNames
# (numpy type, components) to the type of the attribute and of its array. Others are flat arrays
# with an element size.
TYPES: dict[tuple[str, int], tuple[Any, Any]] = {
    ("f4", 1): (Names.FloatArray, Vt.FloatArray),
    ("f4", 2): (Names.Float2Array, Vt.Vec2fArray),
    ("f4", 3): (Names.Float3Array, Vt.Vec3fArray),
    ("f4", 4): (Names.Float4Array, Vt.Vec4fArray),
    ("f8", 1): (Names.DoubleArray, Vt.DoubleArray),
    ("f8", 3): (Names.Double3Array, Vt.Vec3dArray),
    ("i4", 1): (Names.IntArray, Vt.IntArray),
    ("i8", 1): (Names.Int64Array, Vt.Int64Array),
    ("u4", 1): (Names.UIntArray, Vt.UIntArray),
    ("u8", 1): (Names.UInt64Array, Vt.UInt64Array),
}
SMALLER_TYPES = {"f2": "f4", "b1": "i4", "i1": "i4", "i2": "i4", "u1": "i4", "u2": "i4"}


def assemble(folder: Path, frames: Sequence[Frame], run: RunInfo) -> None:
    """Write `scene.usdc` with a prim `/World/<part>` for every part of the frames."""
    with whole_folder(folder / FILE_NAME) as temporary:
        try:
            _write_stage(temporary / FILE_NAME, frames, run)
        except Tf.ErrorException as error:
            # USD tells a full disk in many lines.
            lines = str(error).strip().splitlines()
            is_full = any("No space left" in line for line in lines)
            raise OSError(errno.ENOSPC if is_full else errno.EIO, lines[0]) from error


def _write_stage(path: Path, frames: Sequence[Frame], run: RunInfo) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if run.axes.up == "z" else UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0 / run.axes.scale)
    stage.SetTimeCodesPerSecond(run.fps)
    stage.SetFramesPerSecond(run.fps)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    prims: dict[str, _Prim] = {}
    codes: list[int] = []
    held = 0
    for frame in frames:
        code = frame.index + run.first_number
        for part in frame.parts:
            if part.name not in prims:
                prims[part.name] = _Prim(stage, part)
                if codes:
                    prims[part.name].show(codes[0], False)
            held += prims[part.name].add(part, code)
        for name in prims.keys() - {part.name for part in frame.parts}:
            prims[name].show(code, False)
        codes.append(code)
        if held > HELD_BYTES:
            _save(stage, path)
            held = 0
    stage.SetStartTimeCode(codes[0])
    stage.SetEndTimeCode(codes[-1])
    _save(stage, path)


def _save(stage: Any, path: Path) -> None:
    if not stage.GetRootLayer().Save():
        raise OSError(errno.EIO, f"USD cannot save {path.name}")


class _Prim:
    """One part of the stage while its samples are added."""

    def __init__(self, stage: Any, part: Part) -> None:
        path = f"/World/{part.name}"
        self._kind = kind_of(part)
        self._visible = True
        # The last value of each attribute that is held between samples, and when it began.
        self._last: dict[str, tuple[Array, int]] = {}
        self._sampled: set[str] = set()
        if isinstance(part, Mesh):
            self._geometry = UsdGeom.Mesh.Define(stage, path)
            # The triangles are the surface, not the cage of a subdivision.
            self._geometry.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        elif isinstance(part, Lines):
            self._geometry = UsdGeom.BasisCurves.Define(stage, path)
            self._geometry.CreateTypeAttr(UsdGeom.Tokens.linear)
        else:
            self._geometry = UsdGeom.Points.Define(stage, path)

    def show(self, code: int, visible: bool) -> None:
        """Show or hide the part from time `code` on, where that is a change."""
        if visible != self._visible:
            self._geometry.CreateVisibilityAttr().Set("inherited" if visible else "invisible", code)
            self._visible = visible

    def add(self, part: Part, code: int) -> int:
        """Add the samples of one frame; gives the bytes held for them."""
        self.show(code, True)
        chosen = self._add_cells(part, code)

        def pick(values: Array) -> Array:
            return values if chosen is None else values[chosen]

        position = pick(part.position)
        self._set(self._geometry.CreatePointsAttr(), position, code)
        self._geometry.CreateExtentAttr().Set(_extent(position), code)
        for name, values in part.data.items():
            self._add_data(name, pick(values), "vertex", part.units.get(name, ""), code)
        for name, values in cell_data_of(part).items():
            self._add_data(name, values, "uniform", part.units.get(name, ""), code)
        if (
            self._kind != "triangles"
            and "radius" not in part.data
            and "width" not in self._last
            and len(position)
        ):
            share = LINE_WIDTH if self._kind == "lines" else POINT_WIDTH / len(position) ** (1 / 3)
            width = np.array([share * max(float(np.ptp(position, axis=0).max()), 1e-3)], np.float32)
            self._last["width"] = (width, code)
            self._geometry.CreateWidthsAttr().Set(Vt.FloatArray.FromNumpy(width))
            self._geometry.SetWidthsInterpolation("constant")
        return position.nbytes + sum(values.nbytes for values in part.data.values())

    def _add_cells(self, part: Part, code: int) -> Int | None:
        """The faces, or the curves; gives the points of the part that the prim has, None for all."""
        if isinstance(part, Mesh):
            self._set(self._geometry.CreateFaceVertexIndicesAttr(), part.triangles.reshape(-1), code)
            self._set(
                self._geometry.CreateFaceVertexCountsAttr(), np.full(len(part.triangles), 3, np.int32), code
            )
        if not isinstance(part, Lines):
            return None
        counts, chosen = curves_of(part.segments, joined=not part.cell_data)
        self._set(self._geometry.CreateCurveVertexCountsAttr(), counts, code)
        self._add_data("point", chosen, "vertex", "", code)
        return chosen

    def _add_data(self, name: str, values: Array, interpolation: str, unit: str, code: int) -> None:
        per_point = interpolation == "vertex" and values.dtype == np.float32
        if per_point and name == "velocity" and values.shape[1:] == (3,):
            attribute = self._geometry.CreateVelocitiesAttr()
        elif name == "id" and values.ndim == 1 and values.dtype.kind in "iu" and self._kind == "points":
            attribute, values = self._geometry.CreateIdsAttr(), values.astype(np.int64)
        elif per_point and name == "radius" and values.ndim == 1 and self._kind != "triangles":
            attribute, values = self._geometry.CreateWidthsAttr(), np.multiply(values, np.float32(2.0))
            self._geometry.SetWidthsInterpolation("vertex")
        else:
            values = values.astype(SMALLER_TYPES.get(values.dtype.str[1:], values.dtype.str[1:]), copy=False)
            attribute = self._primvar(name, values, interpolation)
        if unit and not attribute.GetCustomDataByKey("unit"):
            attribute.SetCustomDataByKey("unit", unit)
        self._set(attribute, values, code)

    def _primvar(self, name: str, values: Array, interpolation: str) -> Any:
        primvars = UsdGeom.PrimvarsAPI(self._geometry)
        if name == "color" and values.dtype == np.float32 and values.shape[1:] == (3,):
            return primvars.CreatePrimvar("displayColor", Names.Color3fArray, interpolation).GetAttr()
        type_, _, size = _types(name, values)
        primvar = primvars.CreatePrimvar(Tf.MakeValidIdentifier(name), type_, interpolation)
        if size > 1:
            primvar.SetElementSize(size)
        return primvar.GetAttr()

    def _set(self, attribute: Any, values: Array, code: int) -> None:
        """Set a sample: every frame for what is blended, at changes for whole numbers."""
        key = attribute.GetName()
        _, array, size = _types(key.rpartition(":")[2], values)
        value = array.FromNumpy(np.ascontiguousarray(values.reshape(-1) if size > 1 else values))
        if values.dtype.kind == "f":
            attribute.Set(value, code)
            return
        last = self._last.get(key)
        if last is None:
            attribute.Set(value)
        elif np.array_equal(last[0], values):
            return
        else:
            if key not in self._sampled:
                attribute.Set(attribute.Get(), last[1])
                self._sampled.add(key)
            attribute.Set(value, code)
        self._last[key] = (values.copy(), code)


def _types(name: str, values: Array) -> tuple[Any, Any, int]:
    """Type of the attribute, type of the array, and element size."""
    code, components = values.dtype.str[1:], 1 if values.ndim == 1 else values.shape[1]
    if code == "f4" and is_vector(name, values):
        return Names.Vector3fArray, Vt.Vec3fArray, 1
    if code == "f4" and is_quaternion(name, values):
        return Names.QuatfArray, Vt.QuatfArray, 1
    if (code, components) in TYPES:
        return *TYPES[code, components], 1
    return *TYPES[code, 1], components


def _extent(position: Array) -> Any:
    if len(position) == 0:
        return Vt.Vec3fArray([(0, 0, 0), (0, 0, 0)])
    return Vt.Vec3fArray.FromNumpy(np.stack([position.min(axis=0), position.max(axis=0)]))


def curves_of(segments: Int, joined: bool) -> tuple[Int, Int]:
    """Curves through the segments: points of each curve, and indices of the points, curve by curve.

    Segments that follow each other, each from where the one before ends, are one curve.
    """
    if len(segments) == 0:
        return np.zeros(0, np.int32), np.zeros(0, np.int32)
    starts = np.ones(len(segments), bool)
    if joined:
        starts[1:] = segments[1:, 0] != segments[:-1, 1]
    first = np.flatnonzero(starts)
    counts: NDArray[np.int32] = (np.diff(np.append(first, len(segments))) + 1).astype(np.int32)
    # Every segment gives its end; a segment that starts a curve gives its start before that.
    index: NDArray[np.int32] = np.insert(segments[:, 1], first, segments[first, 0]).astype(np.int32)
    return counts, index
