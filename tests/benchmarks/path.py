"""`fit_mixture` from K = 25 to 1 beside the published component-wise algorithm: time and description length."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach import fit_mixture
from gmmcd_teach.starts import starting_mixture
from tests.benchmarks import literal
from tests.benchmarks.timing import Ratio, cpu_seconds, lab_cloud

CELL = 0.025  # metres


def measure(quick: bool) -> Iterator[Ratio]:
    """Times on one seed, description lengths over all; the fast component-wise update stands in for the slow one."""
    n_points, k, n_seeds = (3_000, 4, 2) if quick else (38_528, 25, 10)
    points = lab_cloud(n_points)
    centre = np.median(points, axis=0)
    start = starting_mixture(points - centre, np.ones(n_points), k, "random", 1e-6, np.random.default_rng(0))
    slow, (length, sweeps) = cpu_seconds(lambda: literal.path(points - centre, start))

    variants = {
        "all points": {},
        f"cells of {100 * CELL:g} cm": {"cell_size": CELL},
        "component-wise": {"update": "componentwise"},
    }
    seconds = {name: np.empty(n_seeds) for name in variants}
    lengths = {name: np.empty(n_seeds) for name in variants}
    for seed in range(n_seeds):
        for name, options in variants.items():
            seconds[name][seed], fit = cpu_seconds(lambda o=options, s=seed: fit_mixture(points, k, rng=s, **o))
            lengths[name][seed] = fit.description_length
    print(f"   the literal algorithm took {slow:.0f} s and {sweeps} sweeps; ours, on the same start, ends", end=" ")
    print(f"{lengths['component-wise'][0] - length:+.3f} nats from it")
    for (name, took), goal in zip(seconds.items(), (30, 100), strict=False):
        yield Ratio(f"{name}: times faster than the literal algorithm", slow / np.median(took), goal)
        longer = lengths[name] - lengths["component-wise"]
        error = longer.std(ddof=1) / np.sqrt(n_seeds)
        yield Ratio(
            f"{name}: nats longer than published, mean of {n_seeds} (± {error:.0f})", longer.mean(), 0, at_most=True
        )
