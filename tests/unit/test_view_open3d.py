"""Open3D: every way in which it can be missing is one clear line, and pictures go on without it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from view_scenes import Film, cube, flock

from tianim.errors import MissingPartError
from tianim.view import open3d_view
from tianim.view.look import Look
from tianim.view.open3d_shapes import corner_normals
from tianim.view.open3d_view import (
    Open3dPainter,
    Probe,
    choose_painter,
    load,
    probe,
    view_run,
)
from tianim.view.painter import Painter

SMALL = Look(width=64, height=36, renderer="open3d")


@pytest.fixture
def fake_module(tmp_path, monkeypatch):
    """Put an `open3d` of the given source before the real one."""

    def put(source):
        (tmp_path / "open3d.py").write_text(source)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "open3d", raising=False)

    yield put
    sys.modules.pop("open3d", None)


def one_line(error):
    return "\n" not in str(error.value) and str(error.value)


def test_a_missing_package_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingPartError) as caught:
        load()
    assert "pip install open3d" in one_line(caught)


def test_a_missing_system_library_is_named_with_what_installs_it(fake_module) -> None:
    fake_module(
        "raise ImportError('libusb-1.0.so.0: cannot open shared object file: No such file or directory')"
    )
    with pytest.raises(MissingPartError) as caught:
        load()
    line = one_line(caught)
    assert "libusb-1.0.so.0" in line
    assert "apt-get install" in line
    assert "libusb-1.0-0" in line


def test_the_window_needs_a_display(fake_module, monkeypatch) -> None:
    fake_module("")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(MissingPartError, match="no display"):
        view_run(Film(2, flock(5)), SMALL)


def answers(monkeypatch, code, stderr=""):
    open3d_view.probe.cache_clear()
    done = subprocess.CompletedProcess([], code, "", stderr)
    monkeypatch.setattr(open3d_view.subprocess, "run", lambda *_, **__: done)


@pytest.mark.parametrize(
    ("code", "stderr", "words"),
    [
        (-6, "terminate called without an active exception", ["Vulkan driver", "mesa-vulkan-drivers"]),
        (134, "", ["Vulkan driver"]),
        (1, "RuntimeError: Failed to load vulkan library!", ["Vulkan", "libvulkan1"]),
        (
            1,
            "tianim.errors.MissingPartError: Open3D is not installed: pip install open3d-cpu",
            ["pip install"],
        ),
        (1, "", ["exit code 1"]),
    ],
)
def test_the_probe_says_in_one_line_why_not(monkeypatch, code, stderr, words) -> None:
    answers(monkeypatch, code, stderr)
    found = probe()
    open3d_view.probe.cache_clear()
    assert not found.usable
    assert "\n" not in found.reason
    assert not found.reason.startswith("tianim.errors")
    assert all(word in found.reason for word in words)


def test_the_probe_tells_when_it_works(monkeypatch) -> None:
    answers(monkeypatch, 0)
    assert probe().usable
    open3d_view.probe.cache_clear()


def test_the_probe_does_not_wait_for_ever(monkeypatch) -> None:
    def hangs(*_, **__):
        raise subprocess.TimeoutExpired("open3d", 1)

    open3d_view.probe.cache_clear()
    monkeypatch.setattr(open3d_view.subprocess, "run", hangs)
    assert not probe().usable
    open3d_view.probe.cache_clear()


@pytest.mark.parametrize(
    ("parts", "usable", "chosen", "line"),
    [
        ((cube(),), True, Open3dPainter, "renderer: open3d"),
        ((cube(),), False, Painter, "renderer: splat (no Vulkan)"),
        (
            flock(5)(0, 0.0),
            True,
            Painter,
            "renderer: splat (open3d draws meshes only, and there are other parts)",
        ),
    ],
)
def test_the_chosen_renderer_is_said(monkeypatch, parts, usable, chosen, line) -> None:
    monkeypatch.setattr(open3d_view, "probe", lambda: Probe(usable, "no Vulkan"))
    said = []
    painter = choose_painter(Film(1, lambda index, time: parts), SMALL, said.append)
    assert type(painter) is chosen
    assert said == [line]


def test_open3d_is_never_tried_unasked(monkeypatch) -> None:
    monkeypatch.setattr(open3d_view, "probe", lambda: pytest.fail("probed"))
    assert type(choose_painter(Film(1, lambda index, time: (cube(),)), Look(), print_nothing)) is Painter


def print_nothing(line):
    assert line == "renderer: splat"


def test_edges_of_a_cube_are_sharp() -> None:
    painter = Painter(Film(1, lambda index, time: (cube(),)), Look(width=64, height=36))
    mesh = painter.draft.geometry(Film(1, lambda index, time: (cube(),))[0]).triangles
    normals = corner_normals(mesh)
    assert np.sort(np.abs(normals), axis=2) == pytest.approx(
        np.broadcast_to([0, 0, 1], normals.shape), abs=1e-6
    )


@pytest.mark.slow
def test_open3d_draws_where_it_works() -> None:
    """In a process of its own: a second renderer, or a missing driver, would end this one."""
    if not probe().usable:
        pytest.skip(probe().reason)
    code = (
        "from tianim import runtime; runtime.start(threads=2)\n"
        "from view_scenes import Film, cube\n"
        "from tianim.view.look import Look\n"
        "from tianim.view.open3d_view import Open3dPainter\n"
        "film = Film(3, lambda index, time: (cube(1 + 0.1 * index),))\n"
        "painter = Open3dPainter(film, Look(width=160, height=90, background='studio', renderer='open3d'))\n"
        "pictures = [painter.picture(k) for k in range(3)]\n"
        "assert all(p.shape == (90, 160, 3) and p.std() > 5 for p in pictures)\n"
        "assert (pictures[0] != pictures[2]).any()\n"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
