"""How fast the package is: a ratio beside each target, both sides measured in one process on one core.

Run `python -m tests.benchmarks`, or some of them by number: `python -m tests.benchmarks 1 4`.
"""

import os

for library in ("OMP", "OPENBLAS", "MKL"):  # before NumPy is imported
    os.environ[f"{library}_NUM_THREADS"] = "1"
