"""Foam of made-up fluids: none at rest, much where sheets break, and each kind moves as it must."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from fluid_clouds import Float, ball, lattice, water

from tianim.errors import SceneError
from tianim.foam import FoamOptions, Surroundings, make_foam
from tianim.foam.kernels import BUBBLE, FOAM, SPRAY
from tianim.foam.making import Foam
from tianim.foam.motion import Fluid, Motion, fluid_of
from tianim.frame import Frame, Points
from tianim.spatial.body_params import Box, Plane
from tianim.system import Bounds

FPS = 30.0
SPACING = 0.05
GRAVITY = 9.81
Flow = Callable[[float], tuple[Float, Float]]
# Positions are float32 [m]: some ulps of a few metres.
ROUNDING = 1e-5


def film(flow: Flow, count: int, spacing: float = SPACING) -> list[Frame]:
    """Frames of a fluid whose position and velocity are functions of time."""
    made = []
    for index in range(count):
        position, velocity = flow(index / FPS)
        part = water(position.astype(np.float32), spacing, velocity)
        made.append(Frame(index, index / FPS, (part,)))
    return made


def foam_of(
    frames: Sequence[Frame], options: FoamOptions | None = None, **surroundings: object
) -> list[tuple[Points, dict[str, float]]]:
    around = Surroundings(("water",), **surroundings)  # type: ignore[arg-type]
    return list(make_foam(frames, around, options or FoamOptions(), "water_foam"))


def at_rest(time: float) -> tuple[Float, Float]:
    position = lattice((0, 0, 0), (1, 0.5, 1), SPACING)
    return position, np.zeros_like(position)


def drifting(time: float) -> tuple[Float, Float]:
    """All of it at 3 m/s, as one: fast, but nothing closes in and the crest is flat."""
    position, velocity = at_rest(time)
    velocity[:, 0] = 3.0
    return position + time * velocity, velocity


def jet(time: float) -> tuple[Float, Float]:
    """A jet that goes down into a pool at 4 m/s."""
    pool = lattice((0, 0, 0), (1, 0.5, 1), SPACING)
    stream = lattice((0.4, 0.55, 0.4), (0.6, 1.5, 0.6), SPACING)
    down = np.zeros_like(stream)
    down[:, 1] = -4.0
    # What has arrived stands still and gives way sideways.
    arrived = stream[:, 1] - 4.0 * time < 0.5
    stream = stream + np.float32(time) * down
    stream[arrived, 1] = 0.5
    down[arrived] = 0.0
    return np.concatenate([pool, stream]), np.concatenate([np.zeros_like(pool), down])


def upwards(position: Float, time: float) -> tuple[Float, Float]:
    """All of it at 3 m/s, up."""
    velocity = np.zeros_like(position)
    velocity[:, 1] = 3.0
    return position + np.float32(time) * velocity, velocity


def sheet(time: float) -> tuple[Float, Float]:
    """A sheet two particles thin that is thrown up: a crest all over."""
    return upwards(lattice((0, 0, 0), (1, 0.1, 1), SPACING), time)


def lump(time: float) -> tuple[Float, Float]:
    """A ball of six spacings that is thrown up: smooth, with nothing thin."""
    return upwards(ball(6 * SPACING, SPACING), time)


@pytest.mark.parametrize("flow", [at_rest, drifting])
def test_a_fluid_that_nothing_tears_makes_no_foam(flow: Flow) -> None:
    options = FoamOptions(wave_crest_rate=0.0)
    for points, row in foam_of(film(flow, 4), options):
        assert row["made"] == 0
        assert points.position.shape == (0, 3)
        assert points.data.keys() == {"id", "kind", "age", "life", "velocity"}


def test_a_still_tank_makes_none_whatever_the_rates() -> None:
    options = FoamOptions(trapped_air_rate=1e6, wave_crest_rate=1e6, trapped_air=(0.0, 0.1))
    assert foam_of(film(at_rest, 3), options)[-1][1]["made"] == 0


def test_a_jet_makes_foam_where_it_goes_in_and_ever_more() -> None:
    made = foam_of(film(jet, 6), FoamOptions(wave_crest_rate=0.0))
    numbers = [row["made"] for _, row in made]
    assert numbers[0] == 0
    assert numbers == sorted(numbers)
    assert numbers[-1] > 100
    points, row = made[-1]
    assert len(points.position) == row["spray"] + row["foam"] + row["bubbles"]
    # Where the jet goes in: on its axis within the reach of the pool, in none of the pool's corners.
    assert np.abs(points.position[:, [0, 2]] - 0.5).max() < 0.1 + 2 * SPACING
    assert points.position[:, 1].min() > 0.5 - 4 * SPACING
    assert points.position[:, 1].max() < 0.5 + 3 * SPACING


def test_a_crest_makes_foam_and_a_slow_one_does_not() -> None:
    quick = foam_of(film(sheet, 3), FoamOptions(trapped_air_rate=0.0))
    assert quick[-1][1]["made"] > 100
    slow = foam_of(film(sheet, 3), FoamOptions(trapped_air_rate=0.0, speed=(5.0, 6.0)))
    assert slow[-1][1]["made"] == 0

    smooth = foam_of(film(lump, 3), FoamOptions(trapped_air_rate=0.0))
    assert smooth[-1][1]["made"] < quick[-1][1]["made"] / 20


def test_the_rate_and_the_time_say_how_much() -> None:
    """Twice the rate gives twice as much, a third of the frames as much in the same time."""

    def made(frames: Sequence[Frame], rate: float) -> float:
        options = FoamOptions(trapped_air_rate=0.0, wave_crest_rate=rate)
        return foam_of(frames, options)[-1][1]["made"]

    every = film(sheet, 4)
    once = made(every, 6000.0)
    # Counts are sums of floor(expected + chance): within three standard deviations of a Poisson number.
    few_percent = 3.0 / np.sqrt(once) * 1.5
    assert few_percent < 0.1
    assert made(every, 12000.0) == pytest.approx(2 * once, rel=few_percent)
    assert made([every[0], every[3]], 6000.0) == pytest.approx(once, rel=few_percent)


def test_the_same_frames_give_the_same_bytes_and_another_seed_others() -> None:
    def bytes_of(seed: int) -> list[bytes]:
        made = foam_of(film(jet, 4), seed=seed)
        return [points.position.tobytes() + points.data["velocity"].tobytes() for points, _ in made]

    assert bytes_of(1) == bytes_of(1)
    assert bytes_of(2**32 - 1)[-1] != bytes_of(1)[-1]  # the largest seed of a scene
    assert bytes_of(1)[-1] != bytes_of(2)[-1]


def drop(options: FoamOptions, velocity: Sequence[float], at: Sequence[float], **around: object) -> Foam:
    """A foam of one particle, before its first step."""
    foam = Foam(Surroundings(("water",), **around), options, SPACING)  # type: ignore[arg-type]
    foam._scatter(
        np.array([[*at, *velocity]], np.float32),
        np.zeros(1, np.int32),
        np.ones(1, np.float32),
        np.ones(1, np.int64),
        0.0,
    )
    foam.cloud.position[:] = at
    foam.cloud.velocity[:] = velocity
    return foam


NOTHING = Fluid(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.int32))


@pytest.mark.parametrize("steps", [1, 7])
def test_spray_falls_with_gravity(steps: int) -> None:
    foam = drop(FoamOptions(), (2.0, 3.0, 0.0), (0.0, 1.0, 0.0))
    for step in range(steps):
        foam.advance(NOTHING, NOTHING, 0.7 * step / steps, 0.7 * (step + 1) / steps)
    points = foam.points("water_foam")
    assert points.data["kind"].tolist() == [SPRAY]
    expected = (1.4, 1.0 + 3.0 * 0.7 - 0.5 * GRAVITY * 0.7**2, 0.0)
    np.testing.assert_allclose(points.position[0], expected, atol=ROUNDING)
    np.testing.assert_allclose(points.data["velocity"][0], (2.0, 3.0 - GRAVITY * 0.7, 0.0), atol=ROUNDING)
    assert points.data["age"][0] == pytest.approx(0.7, abs=ROUNDING)


def pool(velocity: Sequence[float] = (0.0, 0.0, 0.0), time: float = 0.0) -> Fluid:
    position = lattice((0, 0, 0), (1, 0.5, 1), SPACING)
    speed = np.broadcast_to(np.array(velocity, np.float32), position.shape).copy()
    return Fluid(position + np.float32(time) * speed, speed, np.arange(len(position), dtype=np.int32))


def test_a_bubble_rises_and_becomes_foam_at_the_surface() -> None:
    foam = drop(FoamOptions(rise=0.25, lifetime=(5.0, 5.0)), (0.0, 0.0, 0.0), (0.5, 0.2, 0.5))
    kinds, heights = [], []
    for step in range(60):
        foam.advance(pool(), pool(), step / FPS, (step + 1) / FPS)
        kinds.append(int(foam.cloud.kind[0]))
        heights.append(float(foam.cloud.position[0, 1]))
    assert kinds[0] == BUBBLE
    assert kinds[-1] == FOAM
    # Its speed comes near the one it rises at within 1 / drag = 0.05 s.
    assert (heights[15] - heights[9]) * FPS / 6 == pytest.approx(0.25, rel=0.02)
    assert heights[-1] == pytest.approx(0.5, abs=SPACING)
    assert heights[-1] == heights[-10]  # foam rests on fluid at rest


@pytest.mark.parametrize(
    ("at", "kind"),
    [
        ((0.01, 0.2, 0.5), BUBBLE),
        ((0.01, 0.01, 0.01), BUBBLE),
        ((0.5, 0.01, 0.5), BUBBLE),
        ((0.01, 0.5, 0.5), FOAM),
        ((0.01, 0.5, 0.99), FOAM),
        ((0.01, 0.58, 0.5), SPRAY),
    ],
)
def test_at_a_wall_half_a_neighbourhood_is_a_full_one(at: tuple[float, ...], kind: int) -> None:
    """Under water it is a bubble there as elsewhere, and no foam that would lie on the floor."""
    walls = Bounds("contained", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    sides = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    planes = {name: Plane(normal=normal) for name, normal in sides.items()}
    for around in ({"bounds": walls}, {"bodies": planes}):
        foam = drop(FoamOptions(), (0.0, 0.0, 0.0), at, **around)
        foam.advance(pool(), pool(), 0.0, 1e-3)
        assert foam.cloud.kind.tolist() == [kind]


def test_foam_goes_with_the_fluid_and_fades() -> None:
    flow = (0.6, 0.0, 0.0)
    foam = drop(FoamOptions(lifetime=(0.5, 0.5)), (0.0, 0.0, 0.0), (0.5, 0.5, 0.5))
    ages = 0
    for step in range(30):
        foam.advance(pool(flow, step / FPS), pool(flow, (step + 1) / FPS), step / FPS, (step + 1) / FPS)
        if not len(foam.cloud.id):
            break
        ages = step + 1
        assert foam.cloud.kind[0] == FOAM
        np.testing.assert_allclose(foam.cloud.velocity[0], flow, atol=ROUNDING)
        assert foam.cloud.position[0, 0] == pytest.approx(0.5 + 0.6 * (step + 1) / FPS, abs=1e-4)
    assert ages == pytest.approx(0.5 * FPS, abs=1)


def test_walls_and_bodies_keep_spray_out_and_it_dries_there() -> None:
    box = Bounds("contained", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    floor = {"floor": Plane()}
    for around in ({"bounds": box}, {"bodies": floor}):
        foam = drop(FoamOptions(lifetime=(0.5, 0.5)), (1.0, 0.0, 0.0), (0.5, 0.3, 0.5), **around)
        lowest, seen = 1.0, 0
        for step in range(60):
            foam.advance(NOTHING, NOTHING, step / FPS, (step + 1) / FPS)
            if len(foam.cloud.id):
                seen += 1
                lowest = min(lowest, float(foam.cloud.position[0, 1]))
        assert lowest == pytest.approx(0.0, abs=1e-3)
        assert lowest > -1e-3
        # 0.25 s of falling, then half a second on the floor.
        assert seen == pytest.approx(0.75 * FPS, abs=2)


def test_spray_without_end_goes_at_last() -> None:
    foam = drop(FoamOptions(oldest_spray=1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for step in range(40):
        foam.advance(NOTHING, NOTHING, step / FPS, (step + 1) / FPS)
    assert len(foam.cloud.id) == 0


def test_more_than_the_most_is_refused_and_counted() -> None:
    made = foam_of(film(sheet, 4), FoamOptions(most=50))
    assert max(len(points.position) for points, _ in made) == 50
    assert made[-1][1]["refused"] > 0


def test_it_works_in_two_dimensions() -> None:
    def flat(time: float) -> tuple[Float, Float]:
        position = lattice((0, 0), (1, 0.5), SPACING)
        stream = lattice((0.4, 0.52), (0.6, 0.8), SPACING) - (0, np.float32(4.0 * time))
        every = np.concatenate([position, stream])
        velocity = np.zeros((len(every), 3), np.float32)
        velocity[len(position) :, 1] = -4.0
        return np.concatenate([every, np.zeros((len(every), 1))], axis=1), velocity

    points, row = foam_of(film(flat, 4), dimension=2)[-1]
    assert row["made"] > 10
    assert (points.position[:, 2] == 0.0).all()
    assert (points.data["velocity"][:, 2] == 0.0).all()


def test_in_two_dimensions_bodies_keep_foam_out_within_the_plane() -> None:
    """A plate that is thin along z, and a floor that leans: the nearest way out of them is along z."""
    plate = {"plate": Box(size=(2.0, 0.4, 0.1))}
    floor = {"floor": Plane(position=(0.0, 0.2, 0.0), normal=(0.0, 1.0, 0.75))}
    for bodies in (plate, floor):
        foam = drop(FoamOptions(), (1.0, 0.0, 0.0), (0.0, 0.4, 0.0), dimension=2, bodies=bodies)
        for step in range(15):
            foam.advance(NOTHING, NOTHING, step / FPS, (step + 1) / FPS)
        assert foam.cloud.position[0, 1] == pytest.approx(0.2, abs=1e-3)
        assert foam.cloud.position[0, 2] == foam.cloud.velocity[0, 2] == 0.0


def test_a_periodic_box_has_no_seam() -> None:
    """A jet that breaks across the seam makes the foam that it makes in the middle, moved."""
    length = 2.0
    box = Bounds("periodic", (0.0, -1.0, 0.0), (length, 2.0, 1.0))

    def shifted(by: float) -> list[Frame]:
        def flow(time: float) -> tuple[Float, Float]:
            position, velocity = jet(time)
            return np.mod(position + np.array([by, 0, 0], np.float32), [length, 9, 9]), velocity

        return film(flow, 4)

    middle = foam_of(shifted(0.5), bounds=box)[-1]
    seam = foam_of(shifted(1.5), bounds=box)[-1]
    assert middle[1]["made"] > 100
    # Rounding at other places moves a threshold here and there.
    assert seam[1]["made"] == pytest.approx(middle[1]["made"], rel=0.02)
    assert seam[0].position[:, 0].min() >= 0.0
    assert seam[0].position[:, 0].max() <= length
    beyond = seam[0].position[:, 0]
    assert (beyond > 1.5).any()
    assert (beyond < 0.5).any()


def test_a_fluid_that_crosses_a_seam_in_a_frame_makes_the_foam_that_it_makes_elsewhere() -> None:
    """A sheet goes six spacings a frame: at the next frame's start it is cells before the box."""
    box = Bounds("periodic", (0.0, -1.0, -1.0), (2.0, 2.0, 2.0))

    def made(start: float) -> float:
        def flow(time: float) -> tuple[Float, Float]:
            position = lattice((0, 0, 0), (0.1, 1, 1), SPACING)
            velocity = np.zeros_like(position)
            velocity[:, 0] = 6 * SPACING * FPS
            return np.mod(position + time * velocity + [start, 0, 0], [2.0, 9, 9]), velocity

        return foam_of(film(flow, 3), FoamOptions(trapped_air_rate=0.0), bounds=box)[-1][1]["made"]

    middle = made(0.5)
    assert middle > 100
    assert made(1.65) == pytest.approx(middle, rel=0.02)


def test_fluid_between_frames_follows_its_velocities() -> None:
    """A throw: the cubic through both ends and their velocities is the parabola itself."""

    def thrown(time: float) -> Fluid:
        position = np.array([[2.0 * time, 3.0 * time - 0.5 * GRAVITY * time**2, 0.0]], np.float32)
        return Fluid(
            position, np.array([[2.0, 3.0 - GRAVITY * time, 0.0]], np.float32), np.zeros(1, np.int32)
        )

    motion = Motion(thrown(0.0), thrown(0.2), 0.2, np.zeros(3, np.float32))
    for share in (0.0, 0.3, 0.5, 1.0):
        np.testing.assert_allclose(motion.at(share).position, thrown(0.2 * share).position, atol=ROUNDING)
        np.testing.assert_allclose(motion.at(share).velocity, thrown(0.2 * share).velocity, atol=ROUNDING)


def test_particles_that_come_and_go_between_frames() -> None:
    speed = np.full((3, 3), 1.0, np.float32)
    before = Fluid(np.zeros((3, 3), np.float32), speed, np.array([1, 2, 5], np.int32))
    after = Fluid(np.full((3, 3), 0.1, np.float32), speed, np.array([2, 5, 9], np.int32))
    half = Motion(before, after, 0.1, np.zeros(3, np.float32)).at(0.5)
    assert half.id.tolist() == [2, 5, 9]
    np.testing.assert_allclose(half.position, 0.05, atol=ROUNDING)


def test_parts_of_one_fluid_have_ids_of_their_own() -> None:
    cloud = lattice((0, 0, 0), (0.2, 0.2, 0.2), SPACING)
    frame = Frame(0, 0.0, (water(cloud, SPACING), water(cloud, SPACING, name="water_oil")))
    both = fluid_of(frame, ("water", "water_oil"))
    assert len(np.unique(both.id)) == 2 * len(cloud)
    assert (np.diff(both.id) > 0).all()


@pytest.mark.parametrize(
    ("part", "complaint"),
    [
        (Points("water", np.zeros((1, 3), np.float32), {}, {}, SPACING), "'water' has no velocity"),
        (Points("water", np.zeros((1, 3), np.float32)), "'water' does not tell the spacing"),
        (Points("dust", np.zeros((1, 3), np.float32)), "no part of particles is called 'water'"),
    ],
)
def test_frames_that_do_not_do_are_a_line(part: Points, complaint: str) -> None:
    with pytest.raises(SceneError, match=complaint):
        foam_of([Frame(0, 0.0, (part,))])


def test_a_fluid_that_comes_late_and_goes() -> None:
    """Frames without particles at either end, and a fluid that outgrows the room that was made for it."""
    given = [
        Frame(
            index, index / FPS, (water(lattice((0, 0, 0), (0.2 * index + 1e-9, 0.2, 0.2), SPACING), SPACING),)
        )
        for index in (0, 1, 4)
    ]
    given.append(Frame(5, 5 / FPS, (water(np.zeros((0, 3), np.float32), SPACING),)))
    assert len(foam_of(given)) == 4
