"""Plots of validation: published numbers as markers, ours as a line, the tolerance as a band."""

import contextlib
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tianim.errors import OutputError
from tianim.validate.case import Case, Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OURS, PUBLISHED = "tab:blue", "black"


def plot(figure: Figure, measured: Mapping[Case, float], out: Path) -> Path:
    """Write the plot `<figure>.png` into the folder `out`, made if it is not there. Raises OutputError.

    `measured` has the finite numbers only; a figure without any is an empty plot.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(6.4, 4.4), layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.add_subplot()
    if measured:
        _draw(axes, measured)
    axes.set(xlabel=figure.x_label, ylabel=figure.y_label)
    axes.grid(alpha=0.3)
    sources = "; ".join(dict.fromkeys(case.source for case in measured))
    canvas.suptitle(f"{figure.name.replace('_', ' ')}\n{sources}", fontsize=8, wrap=True)
    path, part = out / f"{figure.name}.png", out / f".{figure.name}.tmp"
    try:
        out.mkdir(parents=True, exist_ok=True)
        canvas.savefig(part, format="png", dpi=120)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path


def _draw(axes: "Axes", measured: Mapping[Case, float]) -> None:
    """Band, line and markers."""
    cases = sorted(measured, key=lambda case: case.x)
    x, ranges = [case.x for case in cases], [case.range() for case in cases]
    seen = [*measured.values(), *(limit for pair in ranges for limit in pair if math.isfinite(limit))]
    pad = 0.06 * (max(seen) - min(seen)) or 0.1
    low, high = min(seen) - pad, max(seen) + pad
    # A limit that holds on one side only reaches to the edge of the plot.
    bottom, top = [max(a, low) for a, _ in ranges], [min(b, high) for _, b in ranges]
    label = "tolerance" if all(case.comparison == "equal" for case in cases) else "allowed"
    axes.fill_between(x, bottom, top, color=OURS, alpha=0.18, linewidth=0, label=label)
    if len(cases) == 1:
        axes.vlines(x, bottom, top, color=OURS, alpha=0.3, linewidth=8)
    axes.plot(x, [measured[case] for case in cases], color=OURS, marker=".", label="tianim")
    published = [(case.x, case.expected) for case in cases if case.comparison == "equal"]
    if published:
        axes.plot(*zip(*published, strict=True), "D", color=PUBLISHED, fillstyle="none", label="published")
    axes.set_ylim(low, high)
    axes.legend(frameon=False)
