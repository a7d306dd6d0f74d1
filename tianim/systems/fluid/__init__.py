"""Particle fluids: Position Based Fluids, divergence-free SPH and weakly compressible SPH."""

from tianim.systems.fluid.params import FluidParams
from tianim.systems.fluid.system import Fluid

__all__ = ["Fluid", "FluidParams"]
