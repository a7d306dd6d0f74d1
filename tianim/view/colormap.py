"""Colours: maps as tables of linear light, hex colours, and the encoding to bytes.

Light adds up in linear values; a table of 256 linear colours stands for each map. `phase` is
cyclic with even lightness (made in OKLCh), so that no heading vanishes on a pale or dark ground.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

Float = NDArray[np.float32]

ENTRIES = 256  # colours in a table

_ANCHORS = {
    "viridis": "440154 471063 481f70 472d7b 443983 404688 3b528b 365d8d 31688e 2c728e 287c8e 24868e 21918c "
    "1f9a8a 20a486 28ae80 35b779 48c16e 5ec962 75d054 90d743 addc30 c8e020 e5e419 fde725",
    "magma": "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779 d0416f e75263 f56b5c fc8961 "
    "fea772 fec488 fde2a3 fcfdbf",
    "inferno": "000004 050417 110a30 210c4a 320a5e 450a69 57106e 67166e 781c6d 8a226a 9a2865 ab2f5e bc3754 "
    "ca404a d84c3e e45a31 ed6925 f57b17 f98e09 fca108 fbb61a f9cb35 f4df53 f2f27d fcffa4",
    "plasma": "0d0887 260591 3a049a 4c02a1 5c01a6 6e00a8 7e03a8 8d0ba5 9c179e aa2395 b52f8c c13b82 cc4778 "
    "d5536f de5f65 e66c5c ed7953 f3874a f89540 fca338 fdb42f fdc527 fbd524 f6e826 f0f921",
    "cividis": "00224e 002a5f 003170 1a386f 2a3f6d 38476c 434e6c 4d556c 575d6d 61656f 6a6c71 737475 7d7c78 "
    "868379 918b78 9b9476 a59c74 b0a571 bcae6c c6b667 d2c060 dec958 e9d34e f6dd3f fee838",
    "twilight": "e2d9e2 d1d5da b3c6ce 95b5c7 7ba1c2 6b8cbf 6276ba 5f5eb3 5e43a5 592a8f 4e186f 3d114d 2f1436 "
    "3f123d 581647 741e4f 8e2c50 a24050 b25652 be6f5b c6896c cca389 d4bcac ddd0ce e2d9e2",
    # Orange to blue through white, as the colours of stars by temperature.
    "starlight": "e8703a f58f4c ffab6b ffc593 ffdcbb fff0e2 f6f4ff dde5ff c0d1ff a2bcff 86a8ff 6f97ff",
    "turbo": "30123b 3b2f80 434eba 466be3 4685fa 3ba0fd 28bceb 1ad2d2 1ae4b6 32f298 55fa76 80ff53 a4fc3c "
    "bef434 d9e436 eecf3a faba39 fe9e2f fb7e21 f26014 e4450a d02f05 b91e02 9b0f01 7a0403",
}


def to_linear(encoded: NDArray[np.floating]) -> Float:
    """Linear light of sRGB values in 0..1."""
    encoded = np.asarray(encoded, np.float32)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )


def to_srgb(linear: NDArray[np.floating]) -> Float:
    """SRGB values of linear light, both clipped to 0..1."""
    linear = np.clip(np.asarray(linear, np.float32), 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055).astype(
        np.float32
    )


def hex_to_linear(color: str) -> Float:
    """Linear light, shape (3,), of '#rrggbb'."""
    encoded = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return to_linear(np.array(encoded, np.float32))


@cache
def table(name: str) -> Float:
    """The map `name` as linear light, shape (256, 3)."""
    if name == "phase":
        return _phase()
    if name == "water":
        return _water()
    anchors = np.array([[int(c[k : k + 2], 16) for k in (0, 2, 4)] for c in _ANCHORS[name].split()]) / 255
    places = np.linspace(0.0, 1.0, len(anchors))
    steps = np.linspace(0.0, 1.0, ENTRIES)
    return to_linear(np.stack([np.interp(steps, places, anchors[:, k]) for k in range(3)], axis=1))


def _phase(lightness: float = 0.62, chroma: float = 0.135) -> Float:
    """Hues of even lightness and chroma, all inside sRGB."""
    hue = 2 * np.pi * np.arange(ENTRIES) / ENTRIES
    return _from_oklab(lightness, chroma * np.cos(hue), chroma * np.sin(hue))


def _water() -> Float:
    """Deep blue through cyan to white, in even steps of lightness."""
    share = np.linspace(0.0, 1.0, ENTRIES)
    lightness = 0.30 + 0.68 * share
    hue = np.radians(np.interp(share, [0.0, 0.45, 0.75, 1.0], [262.0, 244.0, 215.0, 205.0]))
    chroma = PchipInterpolator([0.0, 0.2, 0.45, 0.7, 0.88, 1.0], [0.10, 0.125, 0.125, 0.105, 0.045, 0.006])(
        share
    )
    return _from_oklab(lightness, chroma * np.cos(hue), chroma * np.sin(hue))


def _from_oklab(lightness: Any, a: NDArray[np.float64], b: NDArray[np.float64]) -> Float:
    """Linear light of OKLab values (Ottosson 2020), clipped to what can be shown."""
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    medium = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    red = 4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short
    green = -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short
    blue = -0.0041960863 * long - 0.7034186147 * medium + 1.7076147010 * short
    return np.clip(np.stack([red, green, blue], axis=1), 0.0, 1.0).astype(np.float32)


def palette(colors: Sequence[str]) -> Float:
    """A table (256, 3) whose first rows are `colors`; the rest repeat the last."""
    each = np.stack([hex_to_linear(color) for color in colors])
    return each[np.minimum(np.arange(ENTRIES), len(each) - 1)]


def uniform(color: str) -> Float:
    """A table of one colour, shape (256, 3)."""
    return np.tile(hex_to_linear(color), (ENTRIES, 1))


def encoding_table(size: int, steps: float) -> Float:
    """Bytes (as float) of linear light (k / steps)², k below `size`; above 0.8 a shoulder, not a clip."""
    light = (np.arange(size) / steps) ** 2
    bent = np.where(light > 0.8, 1.0 - 0.04 / np.maximum(light - 0.6, 0.2), light)
    return (255.0 * to_srgb(bent)).astype(np.float32)
