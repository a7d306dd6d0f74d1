"""Everything about Open3D: whether it works here, its shading of meshes, and its window.

Open3D is imported only when asked for. Its library needs system libraries that a plain machine
lacks, and its renderer ends the whole process where no Vulkan driver is found: so it is tried in a
process of its own first. One process makes one renderer (a second one ends the process too).
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import MissingPartError
from tianim.frame import Frame, Mesh
from tianim.view.colormap import to_srgb
from tianim.view.layout import FOCAL, HEIGHT, WIDTH
from tianim.view.look import Look
from tianim.view.open3d_shapes import lit_mesh, window_shapes
from tianim.view.painter import Painter
from tianim.view.survey import Frames

Picture = NDArray[np.uint8]
Float = NDArray[np.float32]

PACKAGES = "libgl1 libegl1 libx11-6 libudev1 libidn2-0 libgomp1 libusb-1.0-0 libvulkan1 mesa-vulkan-drivers"
INSTALL = f"apt-get install -y --no-install-recommends {PACKAGES}"
PROBE_SECONDS = 60.0
SUN_LUX = 55_000.0  # with Open3D's own exposure and sky light this keeps our colours
START_ZOOM = 0.6  # of Open3D's window: the action fills most of it
KEYS = {"right": 262, "left": 263, "home": 268, "end": 269, "space": 32}  # of GLFW


@dataclass(frozen=True)
class Probe:
    """Whether Open3D can draw off screen here, and if not, why, in one line."""

    usable: bool
    reason: str


def load() -> ModuleType:
    """The module open3d. Raises MissingPartError naming the package or the system library to install."""
    try:
        import open3d
    except ModuleNotFoundError as error:
        if error.name != "open3d":
            raise MissingPartError(f"Open3D does not import: {error}") from error
        package = "open3d-cpu" if sys.platform == "linux" else "open3d"
        raise MissingPartError(f"Open3D is not installed: pip install {package}") from error
    except (ImportError, OSError) as error:
        raise MissingPartError(_missing_library(str(error))) from error
    return open3d


def _missing_library(message: str) -> str:
    found = re.search(r"(lib[\w.+-]+\.so[\w.]*)", message)
    what = (
        f"the system library {found[1]}" if found else f"system libraries ({message.strip().splitlines()[0]})"
    )
    return f"Open3D needs {what}: {INSTALL}"


@cache
def probe() -> Probe:
    """Try an off-screen picture in a process of its own; takes a second or two, once."""
    code = "from tianim.view import open3d_view; open3d_view.try_here()"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True,
            timeout=PROBE_SECONDS, env=environment,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return Probe(False, f"Open3D gave no picture in {PROBE_SECONDS:g} s")
    if done.returncode == 0:
        return Probe(True, "Open3D draws off screen here")
    if done.returncode < 0 or done.returncode >= 128:  # ended by a signal: no driver
        return Probe(False, f"Open3D finds no Vulkan driver: {INSTALL}")
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    reason = lines[-1] if lines else f"exit code {done.returncode}"
    if "vulkan" in reason.lower() and INSTALL not in reason:
        return Probe(False, f"Open3D finds no Vulkan: {INSTALL}")
    return Probe(False, reason.partition("MissingPartError: ")[2] or reason)


def try_here() -> None:
    """Draw one small picture with Open3D in this process, which may not survive it."""
    renderer = load().visualization.rendering.OffscreenRenderer(64, 64)
    renderer.scene.set_background([1.0, 0.0, 0.0, 1.0])
    picture = np.asarray(renderer.render_to_image())
    if picture.shape != (64, 64, 3) or not picture.any():
        sys.exit("Open3D gave an empty picture")


def choose_painter(frames: Frames, look: Look, say: Any) -> Painter:
    """The painter that the look asks for, or ours where Open3D does not serve; `say` is told which."""
    if look.renderer != "open3d":
        say("renderer: splat")
        return Painter(frames, look)
    painter = Open3dPainter(frames, look)
    if not all(isinstance(part, Mesh) for part in painter.survey.parts.values()):
        reason = "open3d draws meshes only, and there are other parts"
    elif any(style.material is not None for style in look.parts.values()):
        reason = "open3d knows no materials"
    elif not probe().usable:
        reason = probe().reason
    else:
        say("renderer: open3d")
        return painter
    say(f"renderer: splat ({reason})")
    return Painter(frames, look)


@cache
def _renderer(width: int, height: int) -> Any:
    """The one renderer of this process."""
    if _renderer.cache_info().currsize:
        raise MissingPartError("Open3D: one process makes one renderer, of one size")
    with _quiet():
        return load().visualization.rendering.OffscreenRenderer(width, height)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what native code prints off the terminal: it would spoil `--json` and progress bars."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for descriptor in (*kept, nowhere):
            os.close(descriptor)


class Open3dPainter(Painter):
    """Draws films of meshes with Open3D's shading; camera, colours and light are those of our own painter."""

    def draw(self, frame: Frame, index: int, earlier: Sequence[Frame] = ()) -> Picture:
        """The picture of `frame`, which is at `index` of the film."""
        open3d = load()
        view = self.path.at(index, frame.time)
        width, height = int(view.camera[WIDTH]), int(view.camera[HEIGHT])
        scene = _renderer(width, height).scene
        scene.clear_geometry()
        # Our own picture lies behind: its floor has the shadows.
        scene.set_background([0, 0, 0, 1], open3d.geometry.Image(super().draw(frame, index, earlier)))
        rendering = open3d.visualization.rendering
        grading = rendering.ColorGrading(
            rendering.ColorGrading.Quality.HIGH, rendering.ColorGrading.ToneMapping.LINEAR
        )
        scene.view.set_color_grading(grading)
        material = rendering.MaterialRecord()
        material.shader = "defaultLit"
        material.base_roughness = 0.75
        geometry = self.draft.geometry(frame)
        if len(geometry.triangles.triangles):
            scene.add_geometry("meshes", lit_mesh(open3d, geometry, view.camera[:3]), material)
        toward = -self._light(view, geometry).stage[:3].astype(np.float64)
        scene.scene.set_sun_light(toward.tolist(), [1.0, 1.0, 1.0], SUN_LUX)
        scene.scene.enable_sun_light(True)
        _place_camera(scene.camera, view.camera, view.distance, view.radius)
        with _quiet():
            return np.asarray(_renderer(width, height).render_to_image()).copy()


def _place_camera(camera: Any, ours: Float, distance: float, radius: float) -> None:
    eye, up, forward = (ours[k : k + 3].astype(np.float64) for k in (0, 6, 9))
    near, far = max(1e-3 * distance, distance - 8 * radius), distance + 30 * radius
    width, height, focal = float(ours[WIDTH]), float(ours[HEIGHT]), float(ours[FOCAL])
    angle = 2 * np.degrees(np.arctan2(0.5 * height, focal))
    camera.look_at((eye + forward * distance).tolist(), eye.tolist(), up.tolist())
    camera.set_projection(angle, width / height, near, far, type(camera).FovType.Vertical)


class Scrubber:
    """Open3D's window on a run: left and right step, space plays, home and end jump."""

    def __init__(self, frames: Frames, look: Look, title: str = "tianim", visible: bool = True) -> None:
        self._open3d = load()
        self._frames, self.index, self.playing = frames, 0, False
        self._painter = Painter(frames, look)
        self._painter.draft.matt = True
        self._shown: list[Any] = []
        self.window = self._open3d.visualization.VisualizerWithKeyCallback()
        with _quiet():
            opened = self.window.create_window(title, look.width, look.height, visible=visible)
        if not opened:
            raise MissingPartError(
                "Open3D cannot open a window here; `tianim render` gives pictures without one"
            )
        actions = {
            "right": lambda: self.step(1), "left": lambda: self.step(-1), "space": self._toggle,
            "home": lambda: self.show(0), "end": lambda: self.show(len(frames) - 1),
        }  # fmt: skip
        for key, action in actions.items():
            self.window.register_key_callback(KEYS[key], _callback(action))
        options = self.window.get_render_option()
        view = self._painter.path.at(0, 0.0)
        background = self._painter.backdrop.picture(view.camera, 0.0).mean(axis=(0, 1))
        options.background_color = to_srgb(background).astype(np.float64)
        options.mesh_show_back_face = True
        self.show(0)
        control = self.window.get_view_control()
        control.set_front((-view.camera[9:12]).astype(np.float64))
        control.set_up(view.camera[6:9].astype(np.float64))
        control.set_zoom(START_ZOOM)

    def step(self, by: int) -> None:
        """Go `by` frames on, round at the ends."""
        self.show((self.index + by) % max(len(self._frames), 1))

    def _toggle(self) -> None:
        self.playing = not self.playing

    def show(self, index: int) -> None:
        """Show the frame at `index`; the camera stays where the user put it."""
        self.index = index
        first = not self._shown
        for shape in self._shown:
            self.window.remove_geometry(shape, reset_bounding_box=False)
        geometry = self._painter.draft.geometry(self._frames[index])
        self._shown = window_shapes(self._open3d, geometry)
        for shape in self._shown:
            self.window.add_geometry(shape, reset_bounding_box=first)

    def run(self) -> None:
        """Until the window is closed."""
        while self.window.poll_events():
            if self.playing:
                self.step(1)
            self.window.update_renderer()
        self.window.destroy_window()


def _callback(action: Any) -> Any:
    def pressed(_: Any) -> bool:
        action()
        return True

    return pressed


def view_run(frames: Frames, look: Look, title: str = "tianim") -> None:
    """Open a window to go through a run frame by frame.

    Raises MissingPartError where Open3D, one of its libraries or a display is missing.
    """
    load()
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise MissingPartError("no display to open a window on; `tianim render` gives pictures without one")
    if not len(frames):
        raise MissingPartError("the run has no frames to show")
    Scrubber(frames, look, title).run()
