"""Mathematics for kernels and for the host: rotations and counter-based random numbers."""
