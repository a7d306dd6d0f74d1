"""The format gadget: what is in the file, its units, and other programs that open it."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from tianim.errors import FormatError
from tianim.export import OutputOptions, Stamp
from tianim.export.axes import Axes
from tianim.export.exporters import Exporters, Plan
from tianim.export.gadget import KILOPARSEC, SOLAR_MASS, write_part
from tianim.frame import Array, Frame, Points
from tianim.systems.gravity.snapshots import UNITS, read_snapshot

h5py = pytest.importorskip("h5py")

COUNT = 30
GALACTIC = {"position": "kpc", "velocity": "km/s", "mass": "1e10 Msun"}
# Rounding of units that readers convert in float64, and of float32 arrays that pynbody scales in float32.
ROUNDING, ROUNDING_32 = 1e-12, 1e-6
# yt rounds the solar mass and the kiloparsec otherwise than the IAU's nominal values.
CONSTANTS = 1e-4


def stars(count: int = COUNT, units: dict[str, str] | None = None, **more: Array) -> Points:
    rng = np.random.default_rng(4)
    data: dict[str, Array] = {
        "velocity": rng.normal(size=(count, 3)).astype(np.float32) * 100.0,
        "mass": rng.random(count) + 0.5,
        "id": np.arange(count, dtype=np.int32),
        "component": (np.arange(count) % 3).astype(np.int32),
        **more,
    }
    return Points("stars", rng.normal(size=(count, 3)).astype(np.float32), data, units or GALACTIC)


def written(folder: Path, part: Points, axes: Axes | None = None) -> Path:
    path = folder / "stars_0003.hdf5"
    write_part(path, part, Stamp(3, 0.125, axes or Axes()))
    return path


def test_components_become_types_and_nothing_is_lost(tmp_path: Path) -> None:
    part = stars(density=np.arange(COUNT, dtype=np.float32))
    with h5py.File(written(tmp_path, part)) as file:
        header = file["Header"].attrs
        assert header["NumPart_ThisFile"].tolist() == [0, 10, 10, 10, 0, 0]
        assert header["NumPart_Total"].tolist() == [0, 10, 10, 10, 0, 0]
        assert header["MassTable"].tolist() == [0.0] * 6
        assert (header["Time"], header["BoxSize"], header["NumFilesPerSnapshot"]) == (0.125, 0.0, 1)
        for component in range(3):
            group, mine = file[f"PartType{component + 1}"], part.data["component"] == component
            for name, values in {
                "Coordinates": part.position,
                "Velocities": part.data["velocity"],
                "Masses": part.data["mass"],
                "ParticleIDs": part.data["id"],
                "density": part.data["density"],
            }.items():
                np.testing.assert_array_equal(group[name], values[mine], err_msg=name)
                assert group[name].dtype == values.dtype


def test_many_components_share_the_last_type(tmp_path: Path) -> None:
    part = stars(component=np.arange(COUNT, dtype=np.int32))
    with h5py.File(written(tmp_path, part)) as file:
        assert file["Header"].attrs["NumPart_ThisFile"].tolist() == [0, 1, 1, 1, 1, COUNT - 4]
        np.testing.assert_array_equal(file["PartType5/component"], np.arange(4, COUNT))


def test_points_without_mass_weigh_one_by_the_table(tmp_path: Path) -> None:
    plain = stars()
    part = Points("boids", plain.position, {"velocity": plain.data["velocity"]})
    with h5py.File(written(tmp_path, part)) as file:
        assert file["Header"].attrs["MassTable"].tolist() == [0, 0, 0, 0, 1, 0]
        assert list(file["PartType4"]) == ["Coordinates", "ParticleIDs", "Velocities"]
    read = read_snapshot(tmp_path / "stars_0003.hdf5")
    assert read.mass is not None
    assert (read.mass == 1.0).all()


@pytest.mark.parametrize(
    ("units", "scale", "expected"),
    [
        (GALACTIC, 1.0, (KILOPARSEC, 1e10 * SOLAR_MASS, 1e5)),
        ({"position": "m", "velocity": "m/s", "mass": "kg"}, 1.0, (1e2, 1e3, 1e2)),
        ({"position": "m", "velocity": "m/s", "mass": "kg"}, 100.0, (1.0, 1e3, 1.0)),
        # the scale of the output is of metres, not of kiloparsecs
        (GALACTIC, 100.0, (KILOPARSEC, 1e10 * SOLAR_MASS, 1e5)),
    ],
)
def test_units_are_written(
    tmp_path: Path, units: dict[str, str], scale: float, expected: tuple[float, ...]
) -> None:
    with h5py.File(written(tmp_path, stars(units=units), Axes(scale=scale))) as file:
        names = ("UnitLength_in_cm", "UnitMass_in_g", "UnitVelocity_in_cm_per_s")
        assert tuple(file["Parameters"].attrs[name] for name in names) == pytest.approx(expected, rel=1e-15)


def test_units_without_a_name_have_no_parameters(tmp_path: Path) -> None:
    with h5py.File(written(tmp_path, stars(units={"position": "", "velocity": "", "mass": ""}))) as file:
        assert "Parameters" not in file


def test_the_units_agree_with_those_of_the_reader(tmp_path: Path) -> None:
    part = stars()
    read = read_snapshot(written(tmp_path, part), units=UNITS["galactic"])
    order = np.argsort(part.data["component"], kind="stable")
    np.testing.assert_allclose(read.position, part.position[order], rtol=ROUNDING)
    np.testing.assert_allclose(read.velocity, part.data["velocity"][order], rtol=ROUNDING)
    assert read.mass is not None
    np.testing.assert_allclose(read.mass, part.data["mass"][order], rtol=ROUNDING)


def test_a_name_that_gadget_keeps_is_refused(tmp_path: Path) -> None:
    part = stars(Masses=np.ones(COUNT))
    with pytest.raises(
        FormatError, match="'stars' has an array called 'Masses', which gadget keeps for mass"
    ):
        written(tmp_path, part)
    assert list(tmp_path.iterdir()) == []


def test_other_kinds_of_part_are_refused(tmp_path: Path) -> None:
    from tianim.export.roundtrip import sample

    plan = Plan(tmp_path, ("gadget",), OutputOptions(), 25.0)
    with pytest.raises(FormatError, match="format 'gadget' holds points only; part 'sample' is triangles"):
        plan.select(Frame(0, 0.0, (sample("triangles", 3),)))


def test_a_run_has_a_file_a_frame(tmp_path: Path) -> None:
    plan = Plan(tmp_path, ("gadget",), OutputOptions(), 25.0)
    exporters = Exporters(plan)
    for index in range(2):
        exporters.write(plan.select(Frame(index, index / 25.0, (stars(),))))
    exporters.release()
    assert sorted(path.name for path in tmp_path.glob("*.hdf5")) == ["stars_0000.hdf5", "stars_0001.hdf5"]


def test_yt_opens_it(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own making
        yt = pytest.importorskip("yt")
        yt.set_log_level(50)
        part = stars()
        data = yt.load(str(written(tmp_path, part))).all_data()
        for component in range(3):
            mine = part.data["component"] == component
            kind = f"PartType{component + 1}"
            order = np.argsort(data[kind, "particle_index"].v)

            def column(name: str, unit: str, kind: str = kind, order: Array = order) -> Array:
                return np.asarray(data[kind, name].to(unit).v[order])

            np.testing.assert_allclose(column("particle_position", "kpc"), part.position[mine], rtol=1e-6)
            np.testing.assert_allclose(
                column("particle_velocity", "km/s"), part.data["velocity"][mine], rtol=1e-6
            )
            np.testing.assert_allclose(
                column("particle_mass", "Msun"), 1e10 * part.data["mass"][mine], rtol=CONSTANTS
            )


def test_pynbody_opens_it(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its own making
        pynbody = pytest.importorskip("pynbody")
        part = stars()
        snapshot = pynbody.load(str(written(tmp_path, part)))
        order = np.argsort(snapshot["iord"])
        np.testing.assert_allclose(snapshot["pos"].in_units("kpc")[order], part.position, rtol=ROUNDING_32)
        np.testing.assert_allclose(
            snapshot["vel"].in_units("km s**-1")[order], part.data["velocity"], rtol=ROUNDING_32
        )
        np.testing.assert_allclose(
            snapshot["mass"].in_units("Msol")[order], 1e10 * part.data["mass"], rtol=CONSTANTS
        )
