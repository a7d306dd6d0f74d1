"""Counter-based random numbers: a pure function of (seed, id, step, stream), no state to keep.

The hash is pcg4d (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020):
four 32-bit words in, four out, a bijection, so that no two counters give the same four words.
`stream` keeps the draws of one step apart. `words_numpy` gives the same words on the host.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tianim.lang import ti

# Step of the upper 24 bits of a word, all that a float32 in [0, 1) can hold.
ULP = 2.0**-24
TWO_PI = 6.283185307179586
MULTIPLIER = 1664525
INCREMENT = 1013904223


@ti.func
def words(seed, id, step, stream):
    """Four random 32-bit words."""
    x = ti.cast(seed, ti.u32) * ti.u32(MULTIPLIER) + ti.u32(INCREMENT)
    y = ti.cast(id, ti.u32) * ti.u32(MULTIPLIER) + ti.u32(INCREMENT)
    z = ti.cast(step, ti.u32) * ti.u32(MULTIPLIER) + ti.u32(INCREMENT)
    w = ti.cast(stream, ti.u32) * ti.u32(MULTIPLIER) + ti.u32(INCREMENT)
    x += y * w
    y += z * x
    z += x * y
    w += y * z
    x ^= x >> ti.u32(16)
    y ^= y >> ti.u32(16)
    z ^= z >> ti.u32(16)
    w ^= w >> ti.u32(16)
    x += y * w
    y += z * x
    z += x * y
    w += y * z
    return ti.Vector([x, y, z, w], dt=ti.u32)


@ti.func
def unit_interval(word):
    """A 32-bit word as a number in [0, 1)."""
    return ti.cast(word >> ti.u32(8), ti.f32) * ULP


@ti.func
def uniform(seed, id, step, stream):
    """A number in [0, 1)."""
    return unit_interval(words(seed, id, step, stream).x)


@ti.func
def normal3(seed, id, step, stream):
    """Three independent standard normal numbers (Box and Muller)."""
    bits = words(seed, id, step, stream)
    # 1 - u is in (0, 1], where the logarithm is finite.
    r = ti.sqrt(-2.0 * ti.log(1.0 - unit_interval(bits.x)))
    s = ti.sqrt(-2.0 * ti.log(1.0 - unit_interval(bits.y)))
    a = TWO_PI * unit_interval(bits.z)
    b = TWO_PI * unit_interval(bits.w)
    return ti.Vector([r * ti.cos(a), r * ti.sin(a), s * ti.cos(b)])


@ti.func
def unit_vector(seed, id, step, stream, dimension):
    """A direction, every one alike; z = 0 where `dimension` is 2."""
    bits = words(seed, id, step, stream)
    angle = TWO_PI * unit_interval(bits.x)
    z = 2.0 * unit_interval(bits.y) - 1.0
    if dimension == 2:
        z = 0.0
    flat = ti.sqrt(1.0 - z * z)
    return ti.Vector([flat * ti.cos(angle), flat * ti.sin(angle), z])


@ti.func
def smooth_direction(seed, id, time, rate, stream, dimension):
    """A direction that wanders: about `rate` independent ones a second, smoothly joined.

    Normal vectors at the times n / rate are blended, so that no axis is preferred.
    """
    beat = time * rate
    before = ti.floor(beat)
    f = beat - before
    f = f * f * (3.0 - 2.0 * f)
    n = ti.cast(before, ti.i32)
    d = (1.0 - f) * normal3(seed, id, n, stream) + f * normal3(seed, id, n + 1, stream)
    if dimension == 2:
        d.z = 0.0
    return d / ti.max(d.norm(), 1e-20)


def words_numpy(seed: ArrayLike, id: ArrayLike, step: ArrayLike, stream: ArrayLike) -> NDArray[np.uint32]:
    """The same four words on the host, (..., 4), for arguments that broadcast."""
    counters = np.broadcast_arrays(*(np.asarray(value, dtype=np.int64) for value in (seed, id, step, stream)))
    with np.errstate(over="ignore"):
        x, y, z, w = (
            (c & 0xFFFFFFFF).astype(np.uint32) * np.uint32(MULTIPLIER) + np.uint32(INCREMENT)
            for c in counters
        )
        for last in (False, True):
            x = x + y * w
            y = y + z * x
            z = z + x * y
            w = w + y * z
            if not last:
                x, y, z, w = (v ^ (v >> np.uint32(16)) for v in (x, y, z, w))
    return np.stack([x, y, z, w], axis=-1)
