"""Masses and springs: cloth, ropes, jelly, and what lectures draw."""

from tianim.systems.springs.params import SpringsParams
from tianim.systems.springs.system import SpringSystem

__all__ = ["SpringSystem", "SpringsParams"]
