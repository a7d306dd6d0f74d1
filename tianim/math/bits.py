"""Sizes of float32 numbers by their bits: fast arithmetic may assume that there is no NaN."""

from tianim.lang import ti

SIZE_BITS, INFINITY_BITS = 0x7FFFFFFF, 0x7F800000  # all but the sign, and infinity


@ti.func
def size_bits(value):
    """The bits of |value| as float32: in the order of sizes, infinity and NaN last."""
    return ti.bit_cast(ti.cast(value, ti.f32), ti.i32) & SIZE_BITS
