"""Boids; `system.py` is the place to start."""

from tianim.systems.boids.params import BoidsParams
from tianim.systems.boids.system import Boids

__all__ = ["Boids", "BoidsParams"]
