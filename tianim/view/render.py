"""Render: everything visible that a run leaves: film, picture, contact sheet and plots."""

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tianim.errors import MissingPartError
from tianim.export.files import make_folder
from tianim.frame import Frame
from tianim.view import film, open3d_view, plots, sheet
from tianim.view.look import Look
from tianim.view.painter import Painter
from tianim.view.survey import Frames

Picture = NDArray[np.uint8]
Progress = Callable[[int, int], None]
Say = Callable[[str], None]


def _silent(*_: object) -> None:
    """Tell nobody."""


def render_run(
    frames: Frames,
    look: Look,
    folder: Path,
    fps: float,
    metrics: Path | None = None,
    progress: Progress = _silent,
    say: Say = _silent,
) -> list[Path]:
    """Write preview.mp4 (or .webp), preview.png, contact_sheet.png and metrics.png into `folder`.

    `progress(done, total)` counts pictures; `say(line)` is told what was chosen or left out. A film
    of more than `look.film_frames` shows every second, third ... frame at the same rate. A run of
    one frame has no film, one of none has only its plot. Gives the files written.
    Raises SceneError where the look names what the frames do not have, OutputError where a file
    cannot be written.
    """
    written: list[Path] = []
    make_folder(folder)
    if len(frames):
        written += _pictures(frames, look, folder, fps, progress, say)
    if metrics is not None:
        out = folder / "metrics.png"
        try:
            if plots.plot_metrics(metrics, out):
                written.append(out)
        except MissingPartError as error:
            say(str(error))
    return written


def _pictures(
    frames: Frames, look: Look, folder: Path, fps: float, progress: Progress, say: Say
) -> list[Path]:
    painter = open3d_view.choose_painter(frames, look, say)
    indices = film_indices(len(frames), look.film_frames)
    if 1 < len(indices) < len(frames):
        say(f"film: {len(indices)} of {len(frames)} frames, one in every {indices[1]}")
    shown = _Shown(look, indices)
    pictures = shown.watch(_draw_all(painter, frames, indices, progress))
    written = []
    if len(indices) > 1:
        if not film.can_write_mp4():
            say(f"{film.MISSING_VIDEO}; an animated WebP instead")
        written.append(film.write_film(folder / "preview.mp4", pictures, fps))
    for _ in pictures:  # what the film did not take
        pass
    for name, picture in (("preview.png", shown.preview), ("contact_sheet.png", shown.sheet())):
        sheet.write_png(folder / name, picture)
        written.append(folder / name)
    return written


def film_indices(count: int, most: int) -> list[int]:
    """Frames of the film: all, or every n-th so that there are at most `most`."""
    step = -(-count // most)
    return list(range(0, count, step))


def _draw_all(
    painter: Painter, frames: Frames, indices: list[int], progress: Progress
) -> Iterator[tuple[Frame, Picture]]:
    """Each frame of the film with its picture; trails run through the frames of the film."""
    earlier: deque[Frame] = deque(maxlen=painter.trail)
    for done, index in enumerate(indices):
        frame = frames[index]
        picture = painter.draw(frame, index, list(earlier))
        earlier.append(frame)
        progress(done + 1, len(indices))
        yield frame, picture


class _Shown:
    """Picks the preview and the poses of the contact sheet out of the pictures that go by."""

    def __init__(self, look: Look, indices: list[int]) -> None:
        last = len(indices) - 1
        self._preview_at = round(look.preview_at * last)
        self._poses = set(np.linspace(0, last, min(look.sheet, last + 1)).round().astype(int).tolist())
        self._kept: list[tuple[Picture, str]] = []
        self.preview: Picture = np.zeros((look.height, look.width, 3), np.uint8)

    def watch(self, pictures: Iterator[tuple[Frame, Picture]]) -> Iterator[Picture]:
        """Hand the pictures on."""
        for place, (frame, picture) in enumerate(pictures):
            if place == self._preview_at:
                self.preview = picture
            if place in self._poses:
                self._kept.append((picture, f"{frame.time:.2f} s"))
            yield picture

    def sheet(self) -> Picture:
        """The contact sheet of the poses."""
        return sheet.sheet([picture for picture, _ in self._kept], [label for _, label in self._kept])
