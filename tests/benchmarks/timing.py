"""Times that can be compared on a busy machine, and ratios beside their targets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time
from typing import Any

import numpy as np

from gmmcd_teach.study import scan


@dataclass(frozen=True)
class Ratio:
    """One line of the report: `goal` is the least value that meets the target, or with `at_most` the largest."""

    what: str
    value: float
    goal: float
    at_most: bool = False

    def __str__(self) -> str:
        met = self.value <= self.goal if self.at_most else self.value >= self.goal
        target = f"{'at most' if self.at_most else 'at least'} {self.goal:g}"
        return f"{self.what:<62} {self.value:9.2f}   target: {target:<14} {'met' if met else 'MISSED'}"


def medians(
    functions: Mapping[str, Callable[[], Any]], repeats: int, *, in_a_row: int = 1, wall: bool = False
) -> dict[str, float]:
    """Median seconds of a call of each function, all of them in turn, so that a busy moment hits all.

    At its turn a function is called `in_a_row` times, as a fit calls its iterations: the caches then hold its own data,
    not those of the function before. CPU seconds of this process, unless `wall`: neighbours on the machine then do not
    count as much.
    """
    clock = perf_counter if wall else process_time
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():
        function()  # the first call pays for imports and fresh memory
    for _ in range(repeats):
        for name, function in functions.items():
            start = clock()
            for _ in range(in_a_row):
                function()
            seconds[name].append((clock() - start) / in_a_row)
    return {name: median(measured) for name, measured in seconds.items()}


def cpu_seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of one call, and what it returned."""
    start = process_time()
    result = function()
    return process_time() - start, result


def lab_cloud(n_points: int, seed: int = 0) -> np.ndarray:
    """(n_points, 3) metres: a simulated scan of the lab; to get more points, each again with a millimetre of noise."""
    points = scan("cargo_bag", seed).after
    rng = np.random.default_rng(seed)
    if n_points <= len(points):
        return points[rng.choice(len(points), n_points, replace=False)]
    again = points[rng.integers(0, len(points), n_points - len(points))]
    return np.concatenate([points, again + rng.normal(0, 1e-3, again.shape)])
