"""Plots of validation: published numbers as markers, ours as a line, the tolerance as a band."""

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path

from tianim.errors import OutputError
from tianim.validate.case import Case, Figure

OURS, PUBLISHED = "tab:blue", "black"


def plot(figure: Figure, measured: Mapping[Case, float], out: Path) -> Path:
    """Write the plot `<figure>.png` into the folder `out`, made if it is not there. Raises OutputError."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    cases = sorted(measured, key=lambda case: case.x)
    x = [case.x for case in cases]
    canvas = Canvas(figsize=(6.4, 4.4), layout="constrained")
    axes = canvas.add_subplot()
    values = list(measured.values())
    limits = [limit for case in cases for limit in case.range() if abs(limit) != float("inf")]
    low, high = min([*values, *limits]), max([*values, *limits])
    pad = 0.06 * (high - low) or 0.1
    # A limit that holds on one side only reaches to the edge of the plot.
    bands = [(max(a, low - pad), min(b, high + pad)) for a, b in (case.range() for case in cases)]
    label = "tolerance" if all(case.comparison == "equal" for case in cases) else "allowed"
    axes.fill_between(x, *zip(*bands, strict=True), color=OURS, alpha=0.18, linewidth=0, label=label)
    if len(cases) == 1:
        axes.vlines(x, *zip(*bands, strict=True), color=OURS, alpha=0.3, linewidth=8)
    axes.plot(x, [measured[case] for case in cases], color=OURS, marker=".", label="tianim")
    exact = [(case.x, case.expected) for case in cases if case.comparison == "equal"]
    if exact:
        axes.plot(*zip(*exact, strict=True), "D", color=PUBLISHED, fillstyle="none", label="published")
    axes.set(xlabel=figure.x_label, ylabel=figure.y_label, ylim=(low - pad, high + pad))
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    sources = "; ".join(dict.fromkeys(case.source for case in cases))
    canvas.suptitle(f"{figure.name.replace('_', ' ')}\n{sources}", fontsize=8, wrap=True)
    FigureCanvasAgg(canvas)
    path = out / f"{figure.name}.png"
    part = out / f".{figure.name}.tmp"
    try:
        out.mkdir(parents=True, exist_ok=True)
        canvas.savefig(part, format="png", dpi=120)
        os.replace(part, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return path
