"""How time grows with N and K, over two decades of N and K from 5 to 100, and the memory of a large fit."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gmmcd_teach import fit_mixture
from tests.benchmarks.iteration import ours
from tests.benchmarks.timing import Ratio, lab_cloud, medians

ROOT = Path(__file__).resolve().parents[2]
LARGE = """
import numpy as np, resource
from gmmcd_teach import fit_mixture
points = np.random.default_rng(0).normal(size=({n}, 3))
fit_mixture(points, 50, 50, max_iter=2, tol=0)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def measure(quick: bool) -> Iterator[Ratio]:
    """The fitted exponents, and the peak memory of a process that fits a large cloud."""
    sizes = (500, 2_000) if quick else (3_000, 10_000, 30_000, 100_000, 300_000)
    counts = (2, 4) if quick else (5, 10, 20, 50, 100)
    grids = {
        "N, at K = 25": [(n, counts[1] if quick else 25) for n in sizes],
        "K, at N = 30,000": [(sizes[-1] if quick else 30_000, k) for k in counts],
    }
    for name, grid in grids.items():
        clouds = {n: lab_cloud(n) for n, _ in grid}
        fits = {(n, k): fit_mixture(clouds[n], k, k, tol=0, max_iter=3).mixture for n, k in grid}
        seconds = medians({str(size): ours(fits[size], clouds[size[0]]) for size in grid}, 3 if quick else 9)
        x = [size[0] if name[0] == "N" else size[1] for size in grid]
        slope = np.polyfit(np.log(x), np.log(list(seconds.values())), 1)[0]
        yield Ratio(f"time of an iteration grows with {name}, to the power", float(slope), 1.1, at_most=True)
    code = LARGE.format(n=20_000 if quick else 1_000_000)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    unit = 1 if sys.platform == "darwin" else 1024  # what getrusage counts in
    yield Ratio("peak memory of a fit of 1,000,000 points, K = 50, in GB", int(done.stdout) * unit / 1e9, 1.0, True)
