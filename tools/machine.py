"""Is this machine ready for the virtual environment? `make` asks before it builds one.

Checks the Python that will be used, and looks for the shared libraries that the wheels of Taichi
and Open3D expect from the system. Missing ones are installed where the user is root and apt-get
is there, else named in one line. Only what nothing works without stops the set-up.
Runs under the user's own Python, whatever its version: nothing newer than 3.6 in here.
"""

import ctypes
import glob
import importlib.util
import os
import platform
import shutil
import subprocess
import sys

OLDEST, NEWEST = (3, 10), (3, 13)

# Debian's package -> the library in it that a wheel loads.
TAICHI_LIBRARIES = {"libx11-6": "libX11.so.6"}
OPEN3D_LIBRARIES = {
    "libgl1": "libGL.so.1",
    "libegl1": "libEGL.so.1",
    "libudev1": "libudev.so.1",
    "libidn2-0": "libidn2.so.0",
    "libgomp1": "libgomp.so.1",
    "libusb-1.0-0": "libusb-1.0.so.0",
    "libvulkan1": "libvulkan.so.1",
}
# A Vulkan driver says with a file in one of these folders that it is there.
DRIVER_PACKAGE = "mesa-vulkan-drivers"
DRIVER_FILES = (
    "/usr/share/vulkan/icd.d/*.json",
    "/usr/local/share/vulkan/icd.d/*.json",
    "/etc/vulkan/icd.d/*.json",
)

# apt-get gives up soon on a machine without a network.
APT = ["apt-get", "-qq", "-o", "Acquire::Retries=1", "-o", "Acquire::http::Timeout=20"]


def main() -> int:
    """Return 0 where the set-up can go on, else 1 after one line that says what to do."""
    if not OLDEST <= sys.version_info[:2] <= NEWEST:
        found = sys.version.split()[0]
        say(f"Python 3.10 to 3.13 is needed, {sys.executable} is {found}: make PYTHON=python3.12 ...")
        return 1
    missing = needed() + useful()
    if missing and can_install():
        say(f"installing system packages: {' '.join(missing)}")
        install(missing)
    if needed():
        say(f"this system lacks something: apt-get install {' '.join(needed())}")
        return 1
    if useful():
        names = " ".join(useful())
        say(f"Open3D's window and shading lack {names} (Debian's names); everything else works without")
    return 0


def needed() -> list:
    """Missing packages (Debian's names) without which nothing works."""
    missing = [] if importlib.util.find_spec("ensurepip") else [f"python3.{sys.version_info[1]}-venv"]
    return missing + missing_libraries(TAICHI_LIBRARIES)


def useful() -> list:
    """Missing packages (Debian's names) that only Open3D needs."""
    missing = missing_libraries(OPEN3D_LIBRARIES)
    if on_linux() and not any(glob.glob(pattern) for pattern in DRIVER_FILES):
        missing.append(DRIVER_PACKAGE)
    return missing


def missing_libraries(libraries: dict) -> list:
    """Give the packages of `libraries` whose library the system's loader does not find."""
    return [package for package, library in libraries.items() if on_linux() and not loads(library)]


def on_linux() -> bool:
    """Only the wheels for Linux on x86-64 leave libraries to the system."""
    return sys.platform.startswith("linux") and platform.machine() == "x86_64"


def loads(library: str) -> bool:
    """True where the system's loader finds `library`."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def can_install() -> bool:
    """True where the user is root, on a system with apt-get."""
    return hasattr(os, "geteuid") and os.geteuid() == 0 and shutil.which("apt-get") is not None


def install(packages: list) -> None:
    """Try to install `packages`, quietly; the caller looks again for what is missing."""
    environment = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    for command in (["update"], ["install", "--yes", "--no-install-recommends", *packages]):
        subprocess.run(
            APT + command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    importlib.invalidate_caches()


def say(line: str) -> None:
    """Print one line, at once (`make` and pip print too)."""
    print("tianim: " + line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
