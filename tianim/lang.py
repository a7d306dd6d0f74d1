"""The one place that says which compiler the kernels use.

Kernels take `ti` from here: Taichi by default, its maintained fork quadrants where the
environment has `TIANIM_COMPILER=quadrants`. Importing this module starts nothing.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

COMPILERS = ("taichi", "quadrants")
# What to do where one cannot be loaded. Taichi's wheel for Linux needs a library of the system's.
CURES = {
    "taichi": "on Debian and Ubuntu: apt-get install libx11-6",
    "quadrants": "pip install 'tianim[quadrants]'",
}
COMPILER = os.environ.get("TIANIM_COMPILER", "taichi")

# Both compilers greet on standard output when imported, which would spoil `--json`.
os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
os.environ.setdefault("ENABLE_QUADRANTS_HEADER_PRINT", "0")

if TYPE_CHECKING:
    ti: Any
else:
    from tianim.errors import MissingPartError, SceneError

    if COMPILER not in COMPILERS:
        raise SceneError(f"TIANIM_COMPILER={COMPILER!r}: must be one of {', '.join(COMPILERS)}")
    try:
        ti = import_module(COMPILER)
    except ImportError as error:
        raise MissingPartError(f"{COMPILER} cannot be loaded: {error} ({CURES[COMPILER]})") from error

# Kernel arguments: scalar arrays only (arrays of vectors leak and vectorise badly on a CPU).
f32_1d: Any = ti.types.ndarray(dtype=ti.f32, ndim=1)
f32_2d: Any = ti.types.ndarray(dtype=ti.f32, ndim=2)
f32_3d: Any = ti.types.ndarray(dtype=ti.f32, ndim=3)
f64_1d: Any = ti.types.ndarray(dtype=ti.f64, ndim=1)
f64_2d: Any = ti.types.ndarray(dtype=ti.f64, ndim=2)
i32_1d: Any = ti.types.ndarray(dtype=ti.i32, ndim=1)
i32_2d: Any = ti.types.ndarray(dtype=ti.i32, ndim=2)
i64_1d: Any = ti.types.ndarray(dtype=ti.i64, ndim=1)
i64_2d: Any = ti.types.ndarray(dtype=ti.i64, ndim=2)
u8_1d: Any = ti.types.ndarray(dtype=ti.u8, ndim=1)
u8_3d: Any = ti.types.ndarray(dtype=ti.u8, ndim=3)

# Loops of fewer iterations than this run on one core, whatever each costs.
CPU_BLOCK = 512
GPU_TASKS = 1024


def workers() -> tuple[int, int]:
    """(tasks, stride) for loops that hand each worker one long piece of work.

    The CPU back end cuts a parallel loop into blocks of at least 512 iterations, one thread
    each. A loop over `tasks * stride` in which one iteration of `stride` works therefore puts
    one task on each thread. Results must not depend on the number of tasks.
    """
    config = ti.lang.impl.current_cfg()
    if config.arch in (ti.x64, ti.arm64):
        return int(config.cpu_max_num_threads), CPU_BLOCK
    return GPU_TASKS, 1
