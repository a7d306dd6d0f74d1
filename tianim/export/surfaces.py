"""Surfaces: the particles of a fluid as a closed triangle mesh, by pysplashsurf.

A particle's kernel is summed on a grid of cubes, the mesh is cut where the sum crosses a threshold
(marching cubes), slivers are removed, and the mesh is smoothed where particles are dense, so that
sheets lose their bumps and drops keep their size. Löschner, Böttcher, Jeske, Bender: "Weighted
Laplacian Smoothing for Surface Reconstruction of Particle-based Fluids" (VMV 2023).

pysplashsurf adds up in the order in which its threads come: with more than one the last bits of the
smoothed mesh, and now and then the number of its triangles, change from call to call. It is
therefore held to one thread, and many meshes are made at a time in a process each (`workers`).

Cost, one core of an EPYC with its default options: 13 microseconds a particle in a slab (90,000: 1.1 s,
147,000 vertices); 8 with cubes of 1 radius, 26 with cubes of half a radius.
"""

import importlib.util
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import FormatError, MissingPartError, OutputError
from tianim.export.options import SurfaceOptions
from tianim.frame import Array, Frame, Mesh, Part, Points

PACKAGE = "pysplashsurf"
THREADS_VARIABLE = "RAYON_NUM_THREADS"
# Columns of a surface's table, beside frame and time.
AREA, VOLUME, PARTICLES, PARTICLE_VOLUME = "area", "volume", "particles", "particle_volume"


def require() -> None:
    """MissingPartError where surfaces cannot be made here."""
    if importlib.util.find_spec(PACKAGE) is None:
        raise MissingPartError(
            "surfaces of particles need a package that is not installed: pip install 'tianim[surface]'"
        )


@dataclass(frozen=True)
class SurfaceTask:
    """One surface to make: its name, its options, and the particles that it is made of."""

    name: str
    options: SurfaceOptions
    particles: tuple[Points, ...]

    @property
    def radius(self) -> float:
        """Radius of a particle [m]: as asked, or half the particles' spacing."""
        given = self.options.particle_radius
        return given if given is not None else max((one.spacing for one in self.particles), default=0.0) / 2


@dataclass(frozen=True)
class Surface:
    """A surface that was made, and its row of numbers: area [m2], volume [m3] and those of the particles."""

    mesh: Mesh
    row: Mapping[str, float]


def tasks(frame: Frame, surfaces: Mapping[str, SurfaceOptions]) -> tuple[SurfaceTask, ...]:
    """What is to be made of `frame`: the surfaces that it does not have yet."""
    parts = {part.name: part for part in frame.parts}
    made = []
    for name, options in surfaces.items():
        if name not in parts:
            found = (parts.get(one) for one in options.parts)
            particles = tuple(_only(part, options.attributes) for part in found if isinstance(part, Points))
            made.append(SurfaceTask(name, options, particles))
    return tuple(made)


def _only(part: Points, attributes: Iterable[str]) -> Points:
    return Points(
        part.name,
        part.position,
        {name: part.data[name] for name in attributes},
        {name: part.units[name] for name in attributes if name in part.units},
        part.spacing,
    )


def check(frame: Frame, surfaces: Mapping[str, SurfaceOptions]) -> None:
    """FormatError where a surface cannot be made of the parts that `frame` has."""
    for name, options in surfaces.items():
        where = f"output.surfaces.{name}"
        for one in options.parts:
            part = _particles(frame, one, f"{where}.of")
            for attribute in options.attributes:
                _check_attribute(part, attribute, f"{where}.attributes")
            if options.particle_radius is None and not part.spacing:
                raise FormatError(
                    f"{where}.particle_radius: part {one!r} does not tell the spacing of its particles; "
                    "give their radius [m]"
                )


def _particles(frame: Frame, name: str, where: str) -> Points:
    parts: dict[str, Part] = {part.name: part for part in frame.parts}
    part = parts.get(name)
    if part is None:
        raise FormatError(f"{where}: no part is called {name!r}; there are {', '.join(sorted(parts))}")
    if not isinstance(part, Points):
        raise FormatError(f"{where}: part {name!r} has no particles: a surface is made of points")
    return part


def _check_attribute(part: Points, attribute: str, where: str) -> None:
    if attribute not in part.data:
        raise FormatError(
            f"{where}: part {part.name!r} has no {attribute!r}; there are {', '.join(sorted(part.data))}"
        )
    values = part.data[attribute]
    if values.dtype.kind != "f" or values.shape[1:] not in ((), (3,)):
        raise FormatError(
            f"{where}: {attribute!r} has type {values.dtype} and shape {values.shape}; "
            "a surface carries real numbers and vectors of three"
        )


def promise(frame: Frame, surfaces: Mapping[str, SurfaceOptions]) -> Frame:
    """The frame with the surfaces that will be made of it, still empty: for checks before a run."""
    return replace(frame, parts=(*frame.parts, *placeholders(surfaces)))


def placeholders(surfaces: Mapping[str, SurfaceOptions]) -> tuple[Mesh, ...]:
    """The surfaces with nothing in them."""
    nothing = np.zeros((0, 3), np.float32)
    return tuple(
        Mesh(
            name,
            nothing,
            np.zeros((0, 3), np.int32),
            dict.fromkeys(("normal", *options.attributes), nothing),
        )
        for name, options in surfaces.items()
    )


def make_surface(task: SurfaceTask) -> Surface:
    """The surface of a task's particles; without particles an empty mesh.

    The mesh has `normal` and the options' attributes, interpolated. The same particles give the
    same bytes where this process was started for it (see `workers`), or has not used pysplashsurf
    before. Raises OutputError where the particles lie too far apart, or one is not finite.
    """
    os.environ.setdefault(THREADS_VARIABLE, "1")  # read when the first surface is made
    import pysplashsurf

    options, radius = task.options, task.radius
    position, attributes, units = _joined(task)
    try:
        meshed, _ = pysplashsurf.reconstruction_pipeline(
            position,
            attributes_to_interpolate=attributes,
            particle_radius=radius,
            smoothing_length=options.smoothing_length,
            cube_size=options.cube_size,
            iso_surface_threshold=options.threshold,
            mesh_cleanup=True,
            decimate_barnacles=True,
            mesh_smoothing_iters=options.smoothing,
            mesh_smoothing_weights=True,
            compute_normals=True,
            normals_smoothing_iters=options.normal_smoothing,
        )
    except RuntimeError as error:
        raise OutputError(f"surface {task.name!r}: {_reason(error, position)}") from error
    found = meshed.point_attributes
    data = {"normal": found["normals"], **{name: found[name] for name in attributes}}
    mesh = Mesh(
        task.name,
        _float32(meshed.mesh.vertices),
        np.ascontiguousarray(meshed.mesh.triangles, np.int32),  # type: ignore[union-attr]
        {name: _float32(values) for name, values in data.items()},
        units=units,
    )
    area, volume = area_and_volume(mesh)
    filled = sum(len(part.position) * (part.spacing or 2.0 * radius) ** 3 for part in task.particles)
    row = {AREA: area, VOLUME: volume, PARTICLES: len(position), PARTICLE_VOLUME: filled}
    return Surface(mesh, row)


def _joined(task: SurfaceTask) -> tuple[NDArray[np.float32], dict[str, NDArray[np.float32]], dict[str, str]]:
    """Positions, attributes and units of all parts of a task."""
    nothing: list[Array] = [np.zeros((0, 3), np.float32)]
    parts = task.particles
    position = np.concatenate([part.position for part in parts] or nothing)
    names = task.options.attributes
    attributes = {name: np.concatenate([part.data[name] for part in parts] or nothing) for name in names}
    units = {name: unit for part in parts for name, unit in part.units.items()}
    return _float32(position), {name: _float32(values) for name, values in attributes.items()}, units


def _float32(values: Any) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, np.float32)


def _reason(error: RuntimeError, position: NDArray[np.float32]) -> str:
    if not np.isfinite(position).all():
        return "the position of a particle is not finite"
    if "too small to index" in str(error):
        extent = " x ".join(f"{size:.3g}" for size in np.ptp(position, axis=0))
        return f"the particles lie too far apart for its grid: {extent} m"
    return str(error).partition("\n\nStack")[0].replace("\n", " ")


def area_and_volume(mesh: Mesh) -> tuple[float, float]:
    """Area [m2] and enclosed volume [m3] of a closed mesh; negative where its triangles face inwards."""
    if not len(mesh.triangles):
        return 0.0, 0.0
    # From the middle: far from the origin the sum would lose digits.
    position = mesh.position.astype(np.float64)
    a, b, c = (position - position.mean(axis=0))[mesh.triangles.T]
    cross = np.cross(b - a, c - a)
    return 0.5 * float(np.linalg.norm(cross, axis=1).sum()), float((a * cross).sum()) / 6.0


def with_surfaces(frame: Frame, made: Sequence[Surface]) -> Frame:
    """The frame with the surfaces after its other parts."""
    return replace(frame, parts=(*frame.parts, *(one.mesh for one in made)))
