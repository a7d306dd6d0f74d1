"""Plots: the table of metrics of a run as small curves over time, a panel a quantity, a colour a system."""

import csv
import re
from collections.abc import Mapping, Sequence
from itertools import islice
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tianim.errors import MissingPartError, SceneError
from tianim.export.files import whole_file

Column = NDArray[np.float64]

AXES = ("frame", "index", "time")  # columns that number the rows
TIME = "time"
MOST_PANELS = 24
PANEL = (4.3, 2.75)  # inches of one panel
DPI = 100
INK, PAPER, GRID = "#2b2c30", "#faf8f4", "#d9d5cc"
LINES = ("#1f6f9f", "#c0532f", "#3f7d5a", "#8d5a97", "#a8842c", "#5a6472")
MISSING_PLOTS = "no plot of the metrics without matplotlib: pip install 'tianim[plots]'"
UNIT = re.compile(r"^(.*?)\s*[\[(](.+)[\])]\s*$")


def read_metrics(path: Path) -> dict[str, Column]:
    """Columns of a metrics table by name; what is not a number is NaN, and so is a column's short end.

    Raises SceneError where there is no such file, or no table in it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise SceneError(f"cannot read {path}: it is no table ({error})") from error
    if not rows:
        return {}
    names = [name.strip() for name in rows[0]]
    table = np.full((len(rows) - 1, len(names)), np.nan)
    for r, row in enumerate(rows[1:]):
        for c, text in enumerate(row[: len(names)]):
            table[r, c] = _number(text)
    return {name: table[:, c] for c, name in enumerate(names)}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def plot_metrics(metrics: Path, out: Path) -> bool:
    """Draw the columns of the table `metrics` over time; False, and no file, where there is nothing to draw.

    A column called `speed [m/s]` has its unit at the axis. Raises MissingPartError without matplotlib.
    """
    columns = read_metrics(metrics)
    time_name = next((name for name in columns if _split(name)[0] == TIME), None)
    shown = {name: values for name, values in columns.items() if _split(name)[0] not in AXES}
    shown = {name: values for name, values in shown.items() if np.isfinite(values).any()}
    if not shown:
        return False
    if time_name is not None:
        across, label = columns[time_name], "time [s]"
    else:
        across, label = np.arange(len(next(iter(shown.values()))), dtype=np.float64), "frame"
    _draw(across, label, shown, out)
    return True


def _split(name: str) -> tuple[str, str]:
    """Name and unit of a column."""
    found = UNIT.match(name)
    return (found[1], found[2]) if found else (name, "")


def _draw(across: Column, label: str, shown: Mapping[str, Column], out: Path) -> None:
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingPartError(MISSING_PLOTS) from error
    systems = [system for system in _systems(list(shown)) if system]
    together: dict[tuple[str, str], dict[str, Column]] = {}  # what several systems have, by system
    for name, values in shown.items():
        bare, unit = _split(name)
        system, _, what = bare.rpartition(".")
        together.setdefault((what, unit), {})[system] = values
    left_out = len(together) - MOST_PANELS
    together = dict(islice(together.items(), MOST_PANELS))
    count = len(together)
    columns = 1 if count == 1 else 2 if count in (2, 4) else 3
    rows = ceil(count / columns)
    figure = Figure(
        figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.2), dpi=DPI, facecolor=PAPER, layout="constrained"
    )
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, ((what, unit), curves) in zip(panels, together.items(), strict=False):
        for system, values in curves.items():
            color = LINES[systems.index(system) % len(LINES)] if system else LINES[0]
            panel.plot(across, values, color=color, linewidth=2.2, solid_joinstyle="round", label=system)
        title = what.replace("_", " ") + (f" [{unit}]" if unit else "")
        panel.set_title(title, fontsize=16, color=INK, loc="left")
        if len(curves) == 1 and len(systems) > 1 and system:
            panel.set_title(system, fontsize=12, color=color, loc="right")
        _style(panel, np.concatenate(list(curves.values())))
    first = next((k for k, curves in enumerate(together.values()) if len(curves) > 1), None)
    if first is not None:
        handles, labels = panels[first].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=min(len(labels), columns + 1), fontsize=14,
            frameon=False, labelcolor="linecolor",
        )  # fmt: skip
    for panel in panels[count:]:
        panel.set_visible(False)
    for panel in panels[max(0, count - columns) : count]:
        panel.set_xlabel(label, fontsize=14, color=INK)
    if left_out > 0:
        figure.supxlabel(f"and {left_out} more in the table", fontsize=14, color=INK)
    with whole_file(out) as beside:
        figure.savefig(beside, format="png")


def _systems(names: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(_split(name)[0].rpartition(".")[0] for name in names))


def _style(panel: Any, values: Column) -> None:
    """Quiet axes; a constant in the middle of its panel, not stretched to noise."""
    panel.set_facecolor(PAPER)
    panel.grid(color=GRID, linewidth=0.8)
    panel.tick_params(labelsize=13, colors=INK, length=3)
    panel.locator_params(nbins=5)
    panel.margins(x=0.01)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    low, high = np.nanmin(values), np.nanmax(values)
    least = 1e-6 * max(abs(low), abs(high), 1e-12)
    if high - low < least:
        panel.set_ylim(low - max(abs(low) * 0.05, 0.5 * least), high + max(abs(high) * 0.05, 0.5 * least))
