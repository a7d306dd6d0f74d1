"""Write constraints.txt: resolve pyproject.toml anew under each Python named, and merge the answers.

    python tools/constraints.py python3.10 python3.11 python3.12 python3.13

Run it on Linux x86-64. A package that every Python resolves alike gets one line, any other gets
a line for each version with a `python_version` marker.
"""

import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parent.parent
HEADER = """\
# The versions that the tests run with, for Python 3.10 to 3.13. Made by `make constraints`.
"""


def main() -> None:
    """Resolve under each Python of the command line, then write the file."""
    pins: dict[str, dict[str, str]] = defaultdict(dict)
    for python in sys.argv[1:]:
        version, packages = resolve(python)
        print(f"{python}: {len(packages)} packages")
        for name, pin in packages.items():
            pins[name][version] = pin
    # Not resolved on Linux x86-64, where open3d-cpu has its place.
    pins["open3d"] = pins["open3d-cpu"]
    pythons = sorted({version for found in pins.values() for version in found}, key=minor)
    lines = [line for name in sorted(pins, key=str.lower) for line in lines_of(name, pins[name], pythons)]
    (ROOT / "constraints.txt").write_text(HEADER + "\n".join(lines) + "\n")


def resolve(python: str) -> tuple[str, dict[str, str]]:
    """(Python's version, package -> version) that pip chooses for all extras under `python`."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([python, "-m", "venv", folder], check=True)
        pip = [f"{folder}/bin/python", "-m", "pip", "--disable-pip-version-check", "--quiet", "install"]
        asked = ["--dry-run", "--report", "-", "--editable", f"{ROOT}[dev]"]
        report = json.loads(subprocess.run([*pip, *asked], check=True, stdout=subprocess.PIPE).stdout)
    version = report["environment"]["python_version"]
    chosen = (item["metadata"] for item in report["install"])
    return version, {item["name"]: item["version"] for item in chosen if item["name"] != "tianim"}


def lines_of(name: str, found: dict[str, str], pythons: list[str]) -> list[str]:
    """Lines of one package, given its version by Python."""
    groups: dict[str, list[str]] = defaultdict(list)
    for python in pythons:
        if python in found:
            groups[found[python]].append(python)
    return [f"{name}=={pin}{marker(group, pythons)}" for pin, group in groups.items()]


def marker(group: list[str], pythons: list[str]) -> str:
    """Marker that selects the Pythons of `group`, neighbours in `pythons`."""
    if group == pythons:
        return ""
    tests = []
    if group[0] != pythons[0]:
        tests.append(f"python_version >= '{group[0]}'")
    if group[-1] != pythons[-1]:
        tests.append(f"python_version <= '{group[-1]}'")
    if len(group) == 1 and len(tests) == 2:
        tests = [f"python_version == '{group[0]}'"]
    return "; " + " and ".join(tests)


def minor(version: str) -> int:
    """3.13 -> 13."""
    return int(version.partition(".")[2])


if __name__ == "__main__":
    main()
