"""Gravity: from two bodies to colliding galaxies."""

from tianim.systems.gravity.params import GravityParams
from tianim.systems.gravity.system import Gravity

__all__ = ["Gravity", "GravityParams"]
