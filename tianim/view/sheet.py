"""Sheets: several pictures with labels in one, and single pictures as PNG.

A contact sheet shows poses of one film with their times.
"""

from collections.abc import Sequence
from math import ceil
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from tianim.export.files import whole_file

Picture = NDArray[np.uint8]

SHEET_WIDTH = 1920  # pixels
GAP = 10
PAPER = (24, 25, 29)
INK = (226, 224, 218)
FONT_SHARE = 0.075  # height of a label over the height of a picture
LEAST_FONT = 15


def write_png(path: Path, picture: Picture) -> None:
    """Write one picture; the file appears whole."""
    with whole_file(path) as beside:
        Image.fromarray(picture).save(beside, format="PNG", compress_level=6)


def sheet(pictures: Sequence[Picture], labels: Sequence[str]) -> Picture:
    """`pictures` in rows with a label under each; all take the size of the first."""
    if not pictures:
        return np.full((64, 64, 3), PAPER, np.uint8)
    columns = _columns(len(pictures))
    rows = ceil(len(pictures) / columns)
    height, width = pictures[0].shape[:2]
    cell_width = min(width, (SHEET_WIDTH - GAP) // columns - GAP)
    cell_height = max(1, round(height * cell_width / width))
    size = max(LEAST_FONT, round(FONT_SHARE * cell_height))
    step = cell_height + round(1.7 * size) + GAP
    image = Image.new("RGB", (columns * (cell_width + GAP) + GAP, rows * step + GAP), PAPER)
    draw = ImageDraw.Draw(image)
    font = cast(ImageFont.FreeTypeFont, ImageFont.load_default(size))
    for place, (picture, label) in enumerate(zip(pictures, labels, strict=True)):
        x, y = GAP + place % columns * (cell_width + GAP), GAP + place // columns * step
        small = Image.fromarray(picture).resize((cell_width, cell_height), Image.Resampling.LANCZOS)
        image.paste(small, (x, y))
        text = _shortened(draw, label, font, cell_width)
        draw.text((x + 2, y + cell_height + round(0.25 * size)), text, fill=INK, font=font)
    return np.asarray(image)


def _columns(count: int) -> int:
    """Columns for so many pictures: few gaps in the last row, and never more than four."""
    return {1: 1, 2: 2, 3: 3, 4: 2, 5: 3, 6: 3, 9: 3}.get(count, 4)


def _shortened(draw: ImageDraw.ImageDraw, text: str, font: ImageFont.FreeTypeFont, width: int) -> str:
    """`text`, cut with an ellipsis where it is wider than `width`."""
    if draw.textlength(text, font=font) <= width:
        return text
    while text and draw.textlength(text + "...", font=font) > width:
        text = text[:-1]
    return text + "..."
