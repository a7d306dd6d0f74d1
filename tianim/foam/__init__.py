"""Foam, spray and bubbles of a finished run, made from its recorded frames.

    for points, row in make_foam(frames, Surroundings(...), FoamOptions()):
        ...

Reads frames and gives parts of frames: what writes them is `tianim.export`.
"""

from typing import TYPE_CHECKING

from tianim.foam.options import FoamOptions

if TYPE_CHECKING:
    from tianim.foam.making import Surroundings, make_foam

__all__ = ["FoamOptions", "Surroundings", "make_foam"]


def __getattr__(name: str) -> object:
    # Kernels load the compiler: not for reading options.
    if name in ("Surroundings", "make_foam"):
        from tianim.foam import making

        return getattr(making, name)
    raise AttributeError(name)
