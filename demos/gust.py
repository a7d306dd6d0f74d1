"""A gust of wind crosses a flock: a force of your own, step by step, from Python.

    python demos/gust.py [FOLDER]

A front of wind runs through the flock of `configs/murmuration.yaml` at 25 m/s, pushes the birds that it
passes, and is gone. Shows the Python interface: load a scene with overrides, add a force, run it
into a folder, look at arrays, draw the pictures.
"""

import sys
from pathlib import Path

import numpy as np

import tianim
from tianim.view.render import render_run

FRONT_SPEED = 25.0  # [m/s]
FRONT_WIDTH = 4.0  # [m]
GUST = np.array([0.0, 40.0, 10.0])  # acceleration within the front [m/s2]
FRONT_START = -75.0  # where the front is at time 0 [m]


def gust(time, position, velocity):
    """Acceleration (n, 3) [m/s2] of birds at `position` (n, 3) [m]."""
    behind = position[:, 0] - (FRONT_START + FRONT_SPEED * time)
    return np.exp(-((behind / FRONT_WIDTH) ** 2))[:, None] * GUST


def main() -> None:
    """Simulate 4 seconds of 8,000 birds and draw them."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "out/gust")
    tianim.start()
    scene = tianim.load_scene(
        "configs/murmuration.yaml", ["boids.count=8000", "boids.start.radius=12", "duration=4"]
    )
    simulation = tianim.build(scene)
    birds = simulation["boids"]
    birds.add_force(gust)

    frames = []
    for frame in simulation.frames():
        frames.append(frame)
        if frame.index % 30 == 0:
            height = birds.read("position")[:, 1]
            print(
                f"{frame.time:4.1f} s  height {height.mean():5.1f} m  "
                f"polarisation {frame.diagnostics['boids.polarisation']:.2f}"
            )
    for path in render_run(frames, scene.view, folder, scene.fps):
        print(path)


if __name__ == "__main__":
    main()
