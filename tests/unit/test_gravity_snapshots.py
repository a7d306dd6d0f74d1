"""Stars from files: GADGET, NPZ and CSV give the same stars, and what is missing is named."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from gravity_starts import start

from tianim.errors import SceneError
from tianim.systems.gravity.snapshots import UNITS, Units, read_snapshot

COUNT = 6
NAMES = {"position": "Coordinates", "velocity": "Velocities", "mass": "Masses", "id": "ParticleIDs"}


def stars() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    return {
        "position": rng.normal(size=(COUNT, 3)),
        "velocity": rng.normal(size=(COUNT, 3)),
        "mass": rng.random(COUNT),
    }


def gadget(
    path: Path,
    parameters: dict[str, float] | None = None,
    table: float = 0.0,
    header: dict[str, Any] | None = None,
    **changes: Any,
) -> Path:
    """Half of the stars as disk, half as halo; a change of None leaves an array of the disk out."""
    with h5py.File(path, "w") as file:
        counts = [0, COUNT // 2, COUNT // 2, 0, 0, 0]
        file.create_group("Header").attrs["NumPart_ThisFile"] = counts
        file["Header"].attrs["MassTable"] = [0.0, 0.0, table, 0.0, 0.0, 0.0]
        file["Header"].attrs.update(header or {})
        if parameters is not None:
            file.create_group("Parameters").attrs.update(parameters)
        for kind, rows in ((1, slice(0, COUNT // 2)), (2, slice(COUNT // 2, COUNT))):
            group = file.create_group(f"PartType{kind}")
            arrays = {name: values[rows] for name, values in stars().items()} | (changes if kind == 2 else {})
            for name, values in arrays.items():
                if values is not None:
                    group[NAMES[name]] = values
    return path


def npz(path: Path, **changes: Any) -> Path:
    arrays = {name: values for name, values in (stars() | changes).items() if values is not None}
    np.savez(path, **arrays)
    return path


def csv(path: Path, head: str = "vx,vy,vz,name,x,y,z,mass", rows: int = COUNT) -> Path:
    one = stars()
    lines = [
        ",".join([*map(repr, map(float, v)), "s", *map(repr, map(float, x)), repr(float(m))])
        for x, v, m in zip(one["position"], one["velocity"], one["mass"], strict=True)
    ]
    path.write_text("\n".join([head, *lines[:rows]]) + "\n")
    return path


@pytest.mark.parametrize("write", [gadget, npz, csv])
def test_every_format_gives_the_same_stars(tmp_path: Path, write: Any) -> None:
    suffix = {"gadget": ".hdf5", "npz": ".npz", "csv": ".csv"}[write.__name__]
    path = write(tmp_path / f"stars{suffix}")
    read = read_snapshot(path)
    for name, values in stars().items():
        np.testing.assert_array_equal(getattr(read, name), values)
    assert read_snapshot(path, massless=True).mass is None


def test_a_start_takes_a_file(tmp_path: Path) -> None:
    path = npz(tmp_path / "stars.npz")
    made = start({"disk": {"kind": "file", "path": path}}, recentre=False)
    np.testing.assert_array_equal(made.position, stars()["position"])
    np.testing.assert_array_equal(made.mass, stars()["mass"])
    made = start({"disk": {"kind": "file", "path": path, "massless": True}}, recentre=False)
    assert (made.mass == 0.0).all()


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    path = npz(tmp_path / "stars.npz")
    before = read_snapshot(path).position
    npz(path, position=before + 1.0)
    np.testing.assert_array_equal(read_snapshot(path).position, before + 1.0)


def test_types_are_chosen(tmp_path: Path) -> None:
    path = gadget(tmp_path / "stars.hdf5")
    np.testing.assert_array_equal(read_snapshot(path, (2,)).mass, stars()["mass"][COUNT // 2 :])
    np.testing.assert_array_equal(read_snapshot(path, (2, 1)).mass, stars()["mass"])


def test_the_mass_table_stands_for_missing_masses(tmp_path: Path) -> None:
    mass = read_snapshot(gadget(tmp_path / "stars.hdf5", table=0.25, mass=None)).mass
    assert mass is not None
    np.testing.assert_array_equal(mass[COUNT // 2 :], 0.25)


def test_units_are_converted(tmp_path: Path) -> None:
    stated = {"UnitLength_in_cm": 3.0, "UnitMass_in_g": 5.0, "UnitVelocity_in_cm_per_s": 7.0}
    path = gadget(tmp_path / "stars.hdf5", stated)
    read = read_snapshot(path, units=Units(1.0, 1.0, 1.0))
    for name, factor in (("position", 3.0), ("velocity", 7.0), ("mass", 5.0)):
        np.testing.assert_allclose(getattr(read, name), factor * stars()[name], rtol=1e-15)
    # units that nobody states are the system's own
    np.testing.assert_array_equal(read_snapshot(path).position, stars()["position"])


def test_the_units_are_those_of_their_names() -> None:
    # G in cgs, CODATA 2018, gives the constants of the presets; the solar mass is known to 2e-5
    G = 6.6743e-8
    expected = {"galactic": 43007.1, "solar": 4.0 * np.pi**2, "si": 6.6743e-11}
    for name, unit in UNITS.items():
        assert G * unit.mass / (unit.length * unit.velocity**2) == pytest.approx(expected[name], rel=5e-4)


NAN = np.full((COUNT // 2, 3), np.nan)


def words(text: str | bytes) -> Any:
    def write(path: Path) -> None:
        path.write_bytes(text.encode() if isinstance(text, str) else text)

    return write


def array(write: Any, **changes: Any) -> Any:
    return lambda path: write(path, **changes)


UNIT_ZERO = {"UnitLength_in_cm": 0, "UnitMass_in_g": 1, "UnitVelocity_in_cm_per_s": 1}
NONE: dict[str, Any] = {"position": np.zeros((0, 3)), "velocity": np.zeros((0, 3)), "mass": np.zeros(0)}
# The file's name, how it is written, what is said of it.
BAD: dict[str, tuple[str, Any, str]] = {
    "no header": (
        "s.hdf5",
        lambda path: h5py.File(path, "w").close(),
        "no group called Header; there are none",
    ),
    "no place": ("s.hdf5", array(gadget, position=None), "PartType2 holds no dataset called Coordinates"),
    "no velocity": (
        "s.hdf5",
        array(gadget, velocity=None),
        "no dataset called Velocities; there are Coordinates",
    ),
    "no mass": ("s.hdf5", array(gadget, mass=None), "no dataset called Masses and no entry of MassTable"),
    "cosmological": (
        "s.hdf5",
        array(gadget, parameters={"ComovingIntegrationOn": 1}),
        "a cosmological snapshot",
    ),
    "one of four": (
        "s.hdf5",
        array(gadget, header={"NumFilesPerSnapshot": 4}),
        "one of 4 files of a snapshot",
    ),
    "short table": ("s.hdf5", array(gadget, header={"MassTable": [0.0]}), "not a readable .hdf5 file"),
    "one unit": (
        "s.hdf5",
        array(gadget, parameters={"UnitLength_in_cm": 1.0}),
        "holds no unit in Parameters called UnitMass_in_g; there are UnitLength_in_cm",
    ),
    "unit zero": (
        "s.hdf5",
        array(gadget, parameters=UNIT_ZERO),
        "Parameters must be greater than 0: 0, 1, 1",
    ),
    "nan": ("s.hdf5", array(gadget, position=NAN), "position of star 3 is not finite"),
    "shape": ("s.hdf5", array(gadget, mass=np.ones(2)), r"mass has shape \(5,\) of float64; must be \(6,\)"),
    "zero mass": ("s.npz", array(npz, mass=np.zeros(COUNT)), "mass of star 0 is 0; must be greater than 0"),
    "negative mass": ("s.npz", array(npz, mass=-np.ones(COUNT)), "mass of star 0 is -1; must be greater"),
    "npz": ("s.npz", array(npz, velocity=None), "no array called velocity; there are position, mass"),
    "npz of objects": ("s.npz", array(npz, mass=np.array([{}] * COUNT)), "not a readable .npz file"),
    "npz of text": ("s.npz", array(npz, mass=np.array(["a"] * COUNT)), "mass has shape .* of <U1"),
    "empty": ("s.npz", array(npz, **NONE), "holds no stars"),
    "no archive": ("s.npz", words("PK"), "not a readable .npz file"),
    "no hdf5": ("s.hdf5", words("nothing"), "s.hdf5: cannot be read .*signature"),
    "csv": ("s.csv", array(csv, head="vx,vy,w,name,x,y,z,mass"), "no column called vz; there are vx, vy, w"),
    "csv without rows": ("s.csv", array(csv, rows=0), "holds no stars"),
    "csv of nothing": ("s.csv", words(""), "holds no column called x; there are none"),
    "csv of words": ("s.csv", words("x,y,z,vx,vy,vz,mass\n1,2,3,4,5,six,7\n"), "could not convert"),
    "csv of bytes": ("s.csv", words(b"\xff\xfe\x00"), "not a readable .csv file"),
    "other": ("s.txt", words("1 2 3"), "s.txt: not a snapshot; must be one of .hdf5, .h5, .npz"),
    "folder": ("s.npz", Path.mkdir, "s.npz"),
}


def test_a_mark_of_byte_order_is_no_part_of_a_name(tmp_path: Path) -> None:
    path = csv(tmp_path / "stars.csv", head="\ufeffvx,vy,vz,name,x,y,z,mass")
    np.testing.assert_array_equal(read_snapshot(path).velocity, stars()["velocity"])


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_one_line(name: str, tmp_path: Path) -> None:
    file, write, message = BAD[name]
    path = tmp_path / file
    write(path)
    with pytest.raises(SceneError, match=message) as caught:
        read_snapshot(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("types", "suffix", "message"),
    [
        ((3,), ".hdf5", "holds no group called PartType3; there are PartType1, PartType2"),
        ((1,), ".npz", "only GADGET files have types"),
    ],
)
def test_types_that_are_not_there(tmp_path: Path, types: tuple[int, ...], suffix: str, message: str) -> None:
    path = tmp_path / f"s{suffix}"
    (gadget if suffix == ".hdf5" else npz)(path)
    with pytest.raises(SceneError, match=message):
        read_snapshot(path, types)
