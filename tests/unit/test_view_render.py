"""Film, sheets and plots: what a run leaves, and that it appears whole or not at all."""

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image
from view_scenes import Film, flock

from tianim.errors import OutputError, SceneError
from tianim.view import film as film_module
from tianim.view import render
from tianim.view.film import write_film, write_mp4
from tianim.view.look import Look
from tianim.view.painter import Painter
from tianim.view.plots import plot_metrics, read_metrics
from tianim.view.render import film_indices, render_run
from tianim.view.sheet import sheet

SMALL = Look(width=96, height=54, samples=1, sheet=3, background="night")
METRICS = """frame,time [s],boids.polarisation,boids.mean_speed [m/s],note
0,0.0,0.5,1,a
1,0.1,0.6,,b
2,0.2,0.7,3
"""


def ramp(count, height=54, width=96):
    """Pictures that grow brighter."""
    for k in range(count):
        yield np.full((height, width, 3), 20 + 10 * k, np.uint8)


def decoded(path):
    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        return stream.average_rate, [frame.to_ndarray(format="rgb24") for frame in file.decode(stream)]


def left_over(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_a_film_has_all_pictures_in_order_at_their_rate(tmp_path) -> None:
    write_mp4(tmp_path / "a.mp4", ramp(12), 24.0)
    rate, pictures = decoded(tmp_path / "a.mp4")
    assert rate == Fraction(24)
    assert len(pictures) == 12
    levels = [picture.mean() for picture in pictures]
    np.testing.assert_allclose(levels, 20 + 10 * np.arange(12), atol=4)  # H.264 is not exact


def test_a_film_plays_while_it_loads_and_says_its_colours(tmp_path) -> None:
    write_mp4(tmp_path / "a.mp4", ramp(3), 30.0)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    with av.open(str(tmp_path / "a.mp4")) as file:
        context = file.streams.video[0].codec_context
        assert context.pix_fmt == "yuv420p"
        assert (context.colorspace, context.color_primaries, context.color_trc) == (1, 1, 1)


def test_colours_of_a_film_are_those_of_its_pictures(tmp_path) -> None:
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[:] = (200, 90, 40)
    write_mp4(tmp_path / "a.mp4", [picture] * 3, 30.0)
    with av.open(str(tmp_path / "a.mp4")) as file:
        frame = next(file.decode(video=0))
        shown = frame.reformat(format="rgb24", src_colorspace=1, src_color_range=1).to_ndarray()
    np.testing.assert_allclose(shown[32, 32], (200, 90, 40), atol=6)


def test_an_odd_side_loses_one_row(tmp_path) -> None:
    write_mp4(tmp_path / "a.mp4", ramp(2, 55, 97), 30.0)
    assert decoded(tmp_path / "a.mp4")[1][0].shape == (54, 96, 3)


def test_a_film_that_breaks_off_leaves_nothing(tmp_path) -> None:
    def broken():
        yield from ramp(5)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_mp4(tmp_path / "a.mp4", broken(), 30.0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("pictures", [0, 3])
def test_a_film_that_cannot_be_written_says_so_in_one_line(tmp_path, pictures) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write") as caught:
        write_film(tmp_path / "file" / "a.mp4", ramp(pictures), 30.0)
    assert "\n" not in str(caught.value)


def test_without_pyav_there_is_an_animated_webp(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(film_module, "can_write_mp4", lambda: False)
    path = write_film(tmp_path / "a.mp4", ramp(12), 30.0)
    assert path == tmp_path / "a.webp"
    with Image.open(path) as image:
        assert image.n_frames == 6  # every second: 15 a second are enough
        image.seek(1)
        image.load()
        assert image.info["duration"] == pytest.approx(1000 / 15, abs=1)
    assert left_over(tmp_path) == []


def test_a_run_leaves_film_picture_sheet_and_plot(tmp_path) -> None:
    metrics = tmp_path / "metrics.csv"
    metrics.write_text(METRICS)
    seen, said = [], []
    written = render_run(
        Film(11, flock(60)),
        SMALL,
        tmp_path,
        30.0,
        metrics,
        lambda done, of: seen.append((done, of)),
        said.append,
    )
    assert [path.name for path in written] == [
        "preview.mp4",
        "preview.png",
        "contact_sheet.png",
        "metrics.png",
    ]
    assert seen == [(k, 11) for k in range(1, 12)]
    assert said == ["renderer: splat"]
    _, pictures = decoded(tmp_path / "preview.mp4")
    assert len(pictures) == 11
    preview = np.asarray(Image.open(tmp_path / "preview.png"))
    assert preview.shape == (54, 96, 3)
    errors = [np.abs(preview.astype(float) - picture).mean() for picture in pictures]
    assert int(np.argmin(errors)) == 6  # at 60 %
    assert left_over(tmp_path) == []


@pytest.mark.parametrize(("moment", "frame"), [(0.0, 0), (0.5, 2), (1.0, 4)])
def test_a_scene_says_which_moment_its_picture_shows(tmp_path, moment: float, frame: int) -> None:
    look = Look.model_validate({**SMALL.model_dump(), "preview_at": moment})
    film = Film(5, flock(60, drift=(9, 0, 0)))
    render_run(film, look, tmp_path, 30.0)
    with Image.open(tmp_path / "preview.png") as preview:
        np.testing.assert_array_equal(np.asarray(preview), Painter(film, look).picture(frame))


def test_the_pictures_of_a_run_have_trails_and_times(tmp_path, monkeypatch) -> None:
    look = Look.model_validate({**SMALL.model_dump(), "parts": {"boids": {"trail": 4, "size": 0.3}}})
    film, labels, make = Film(6, flock(60, drift=(9, 0, 0))), [], render.sheet.sheet
    monkeypatch.setattr(
        render.sheet, "sheet", lambda pictures, names: labels.extend(names) or make(pictures, names)
    )
    render_run(film, look, tmp_path, 30.0)
    with Image.open(tmp_path / "preview.png") as preview:
        np.testing.assert_array_equal(np.asarray(preview), Painter(film, look).picture(3))
    assert labels == ["0.00 s", "0.07 s", "0.17 s"]


@pytest.mark.parametrize(("count", "names"), [(0, []), (1, ["preview.png", "contact_sheet.png"])])
def test_short_runs_leave_what_they_can(tmp_path, count, names) -> None:
    written = render_run(Film(count, flock(10)), SMALL, tmp_path, 30.0)
    assert [path.name for path in written] == names


def test_without_pyav_a_run_still_leaves_everything(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(film_module, "can_write_mp4", lambda: False)
    said = []
    written = render_run(Film(4, flock(10)), SMALL, tmp_path, 30.0, say=said.append)
    assert [path.name for path in written] == ["preview.webp", "preview.png", "contact_sheet.png"]
    assert any("tianim[video]" in line for line in said)


def test_a_long_run_is_shown_in_steps(tmp_path) -> None:
    said = []
    look = SMALL.model_copy(update={"film_frames": 4})
    render_run(Film(10, flock(10)), look, tmp_path, 30.0, say=said.append)
    assert len(decoded(tmp_path / "preview.mp4")[1]) == 4
    assert "film: 4 of 10 frames, one in every 3" in said


def test_film_indices_start_at_the_first_and_keep_the_limit() -> None:
    for count in (1, 2, 7, 600, 601, 5000):
        indices = film_indices(count, 600)
        assert indices[0] == 0
        assert len(indices) <= 600
        assert len(set(np.diff(indices))) <= 1


def test_a_look_with_an_unknown_part_is_refused_before_anything_is_written(tmp_path) -> None:
    look = Look.model_validate({**SMALL.model_dump(), "parts": {"fish": {}}})
    with pytest.raises(SceneError, match="fish"):
        render_run(Film(3, flock(10)), look, tmp_path, 30.0)
    assert list(tmp_path.iterdir()) == []


def test_a_sheet_shows_every_picture_once_under_its_place() -> None:
    pictures = [np.full((90, 160, 3), 10 * k, np.uint8) for k in range(1, 8)]
    shown = sheet(pictures, [f"{k} s" for k in range(7)])
    for k in range(1, 8):
        assert (shown == 10 * k).all(axis=2).sum() >= 90 * 160 * 0.98
    assert shown.shape[1] == 4 * 170 + 10


def test_a_sheet_cuts_labels_that_are_too_long() -> None:
    pictures = [np.zeros((54, 96, 3), np.uint8)]
    short, long = (
        sheet(pictures, [label])[64:].astype(int) for label in ("boids.count=1", "boids.count=1" * 40)
    )
    assert short.shape == long.shape
    assert (long[:, -8:] == long[0, -1]).all()  # the margin stays clean


def test_metrics_are_read_with_gaps(tmp_path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text(METRICS)
    columns = read_metrics(path)
    np.testing.assert_array_equal(columns["boids.mean_speed [m/s]"], [1, np.nan, 3])
    assert np.isnan(columns["note"]).all()


@pytest.mark.parametrize("text", ["", "frame,time\n0,0\n1,0.1\n", "frame,time,note\n0,0,a\n"])
def test_no_metrics_make_no_plot(tmp_path, text) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text(text)
    assert not plot_metrics(path, tmp_path / "metrics.png")
    assert not (tmp_path / "metrics.png").exists()


@pytest.mark.parametrize(
    ("count", "across", "down"), [(1, 1, 1), (2, 2, 1), (4, 2, 2), (5, 3, 2), (30, 3, 8)]
)
def test_every_metric_has_a_panel_up_to_a_limit(tmp_path, monkeypatch, count, across, down) -> None:
    said = []
    monkeypatch.setattr("matplotlib.figure.Figure.supxlabel", lambda self, text, **_: said.append(text))
    path = tmp_path / "metrics.csv"
    names = [f"s{k % 3}.value_{k} [m]" for k in range(count)]
    rows = [",".join(map(str, [k, k / 30, *np.sin(np.arange(count) + k)])) for k in range(20)]
    path.write_text("\n".join(["frame,time," + ",".join(names), *rows]))
    assert plot_metrics(path, tmp_path / "metrics.png")
    with Image.open(tmp_path / "metrics.png") as image:
        assert image.size == (430 * across, 275 * down + 20)
        drawn = np.asarray(image.convert("L"), int)
    curves = [
        panel[20:-40].min() < 160  # the ink of a curve and of the numbers beside it
        for row in np.array_split(drawn[:-20], down)
        for panel in np.array_split(row, across, axis=1)
    ]
    assert sum(curves) == min(count, 24)
    assert said == (["and 6 more in the table"] if count > 24 else [])


def test_a_quantity_of_several_systems_is_one_panel(tmp_path) -> None:
    rows = [f"{k},{k / 30},{k},{-k},3" for k in range(20)]
    (tmp_path / "metrics.csv").write_text("\n".join(["frame,time,a.energy,b.energy,b.spin", *rows]))
    assert plot_metrics(tmp_path / "metrics.csv", tmp_path / "metrics.png")
    with Image.open(tmp_path / "metrics.png") as image:
        assert image.size == (860, 295)
        drawn = np.asarray(image.convert("RGB"), int)[:, :430]
    for ink in ((0x1F, 0x6F, 0x9F), (0xC0, 0x53, 0x2F)):
        assert (np.abs(drawn - ink).max(axis=2) < 30).sum() > 200


def test_a_constant_is_a_straight_line_in_the_middle_of_its_panel(tmp_path) -> None:
    noise = np.random.default_rng(0).normal(size=30) * 1e-9
    rows = [f"{k},{k / 30},{float(7 + noise[k])!r}" for k in range(30)]
    (tmp_path / "metrics.csv").write_text("\n".join(["frame,time,s.energy", *rows]))
    assert plot_metrics(tmp_path / "metrics.csv", tmp_path / "metrics.png")
    with Image.open(tmp_path / "metrics.png") as image:
        ink = np.abs(np.asarray(image.convert("RGB"), int) - (0x1F, 0x6F, 0x9F)).max(axis=2) < 30
    rows_of_ink = np.nonzero(ink)[0]
    assert np.ptp(rows_of_ink) <= 4
    assert 90 < rows_of_ink.mean() < 190


@pytest.mark.parametrize(
    "content", [b"time,a\n0,\xff\xfe\n", b"time,a\n0," + b"9" * 200_000], ids=["bytes", "long"]
)
def test_metrics_that_are_no_table_say_so(tmp_path, content) -> None:
    (tmp_path / "metrics.csv").write_bytes(content)
    with pytest.raises(SceneError, match=r"metrics\.csv: it is no table") as caught:
        plot_metrics(tmp_path / "metrics.csv", tmp_path / "metrics.png")
    assert "\n" not in str(caught.value)


def test_metrics_that_are_not_there_say_so(tmp_path) -> None:
    with pytest.raises(SceneError, match=r"metrics\.csv"):
        plot_metrics(tmp_path / "metrics.csv", tmp_path / "metrics.png")
