"""What this installation is: versions, machine, usable back ends, optional parts.

`versions` and `machine` are cheap and go into every run.json. What may hang or abort a process
(graphics drivers) is tried in child processes, side by side.
"""

import contextlib
import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import tianim
from tianim.lang import COMPILER

PACKAGES = ("numpy", "scipy", "pydantic", "meshio", "h5py", "trimesh", "pillow", "pysplashsurf")
# Part -> the packages one of which brings it.
PARTS = {
    "open3d": ("open3d", "open3d-cpu"),
    "av": ("av",),
    "usd-core": ("usd-core",),
    "pysplashsurf": ("pysplashsurf",),
    "quadrants": ("quadrants",),
}
# What shows that a part can be used; Open3D's own system libraries may need help.
TRIALS = {"usd-core": "import pxr", "open3d": "from tianim.view.open3d_view import load; load()"}
ARCHES = ("cpu", "cuda", "vulkan")
# A driver that does not answer in this time counts as not usable [s].
PROBE_SECONDS = 60.0


def versions() -> dict[str, str]:
    """Versions that a run's result depends on, by package."""
    found = {"tianim": tianim.__version__, "python": platform.python_version()}
    found["compiler"] = f"{COMPILER} {installed(COMPILER)}"
    return found | {name: installed(name) for name in PACKAGES}


def installed(*names: str) -> str:
    """Version of the first of the packages `names` that is installed, else "not installed"."""
    for name in names:
        with contextlib.suppress(PackageNotFoundError):
            return version(name)
    return "not installed"


def machine() -> dict[str, str | int | float]:
    """System, processor, cores, memory [GB]; no name of the machine or its user."""
    return {
        "system": f"{platform.system()} {platform.release()}",
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "memory_gb": _memory_gb(),
    }


def back_ends() -> dict[str, str]:
    """`usable` or why not, for each back end that Taichi may run on."""
    code = "from tianim import runtime; runtime.start({0!r})"
    return probe({arch: code.format(arch) for arch in ARCHES})


def parts() -> dict[str, str]:
    """Version of each optional part, and why it is not usable where its import fails."""
    there = {name: installed(*packages) for name, packages in PARTS.items()}
    trials = {name: TRIALS.get(name, f"import {name}") for name in PARTS if there[name] != "not installed"}
    return there | {
        name: there[name] if result == "usable" else f"{there[name]}, {result}"
        for name, result in probe(trials).items()
    }


def probe(codes: dict[str, str]) -> dict[str, str]:
    """Run each piece of Python in a child process: `usable`, or the last line of its complaint."""
    children = {
        name: subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        for name, code in codes.items()
    }
    return {name: _outcome(child) for name, child in children.items()}


def _outcome(child: "subprocess.Popen[str]") -> str:
    try:
        _, complaint = child.communicate(timeout=PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()
        return f"not usable: no answer in {PROBE_SECONDS:.0f} s"
    if child.returncode == 0:
        return "usable"
    lines = complaint.strip().splitlines()
    last = lines[-1] if lines else f"ended with status {child.returncode}"
    return f"not usable: {last.partition('Error: ')[2] or last}"


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory_gb() -> float:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1)
    except (AttributeError, ValueError, OSError):
        return 0.0
