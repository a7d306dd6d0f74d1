"""Film: pictures to MP4 (H.264 through PyAV), or to an animated WebP where PyAV is not installed.

Pictures are taken one by one and never held together. The file appears when it is complete.
"""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tianim.errors import MissingPartError, OutputError
from tianim.export.files import whole_file

Picture = NDArray[np.uint8]

QUALITY = "23"  # constant rate factor of x264: a flock of 30,000 in 10 s takes 14 MB, at 20 it takes 19
MOST_BITS = "12M"  # a second: pure noise of small things would take three times that
PRESET = "veryfast"  # half the time of `medium` for a few percent of size
BT709 = 1  # colour code of HD film, in the numbering of ITU-T H.273
WEBP_WIDTH = 960
WEBP_RATE = 15.0  # most pictures a second
MISSING_VIDEO = "no MP4 without PyAV: pip install 'tianim[video]'"


def can_write_mp4() -> bool:
    """Whether PyAV is installed, with the encoder."""
    try:
        import av
    except ImportError:
        return False
    return "libx264" in av.codecs_available


def write_film(path: Path, pictures: Iterable[Picture], rate: float) -> Path:
    """Write `pictures` at `rate` a second; gives the file: `path`, or a .webp where PyAV is missing."""
    if can_write_mp4():
        write_mp4(path, pictures, rate)
        return path
    path = path.with_suffix(".webp")
    write_webp(path, pictures, rate)
    return path


def write_mp4(path: Path, pictures: Iterable[Picture], rate: float) -> None:
    """H.264 in yuv420p, ready to play while it loads. An odd row or column is cut off.

    Raises MissingPartError without PyAV, OutputError where the file cannot be written.
    """
    if not can_write_mp4():
        raise MissingPartError(MISSING_VIDEO)
    import av

    pictures = iter(pictures)
    first = next(pictures, None)
    if first is None:
        raise OutputError(f"cannot write {path}: the film has no pictures")
    height, width = (side - side % 2 for side in first.shape[:2])
    with (
        whole_file(path) as beside,
        av.open(str(beside), "w", format="mp4", options={"movflags": "faststart"}) as out,
    ):
        stream = out.add_stream("libx264", rate=Fraction(rate).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": QUALITY, "preset": PRESET, "maxrate": MOST_BITS, "bufsize": MOST_BITS}
        context = stream.codec_context
        context.color_primaries = context.color_trc = context.colorspace = BT709
        context.color_range = 1  # of film, 16 to 235
        for picture in _chain(first, pictures):
            cut = np.ascontiguousarray(picture[:height, :width])
            frame = av.VideoFrame.from_ndarray(cut, format="rgb24")
            out.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace=BT709, dst_color_range=1)))
        out.mux(stream.encode())


def write_webp(path: Path, pictures: Iterable[Picture], rate: float) -> None:
    """An animated WebP, smaller and of fewer pictures than the film."""
    skip = max(1, round(rate / WEBP_RATE))
    small = (_small(picture) for picture in islice(pictures, 0, None, skip))
    first = next(small, None)
    if first is None:
        raise OutputError(f"cannot write {path}: the film has no pictures")
    with whole_file(path) as beside:
        first.save(
            beside, format="WEBP", save_all=True, append_images=small,
            duration=1000 * skip / rate, loop=0, quality=80,
        )  # fmt: skip


def _small(picture: Picture) -> Image.Image:
    image = Image.fromarray(picture)
    if image.width <= WEBP_WIDTH:
        return image
    return image.resize(
        (WEBP_WIDTH, round(image.height * WEBP_WIDTH / image.width)), Image.Resampling.LANCZOS
    )


def _chain(first: Picture, rest: Iterable[Picture]) -> Iterator[Picture]:
    yield first
    yield from rest
