"""Benchmarks: the kernels of the demos with other parameters, alone or beside other programs.

    for line in run("boids", sizes=[10_000], peers=Path("peers")):
        print(line["engine"], line["n"], line["dim"], line["ms_per_step"], line["ratio"])

Importing this loads no compiler: every measurement runs in a process of its own.
"""

from tianim.bench.cases import CASES, Case
from tianim.bench.running import run

__all__ = ["CASES", "Case", "run"]
