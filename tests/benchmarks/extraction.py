"""Greedy extraction at K = 50 beside solving every candidate with a general solver of linear programmes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach import GaussianMixture, emd, extract_changes, mean_distances
from tests.benchmarks.timing import Ratio, cpu_seconds, medians


def measure(quick: bool) -> Iterator[Ratio]:
    """The time, after the same components were taken in the same order."""
    before, after = rooms(6 if quick else 50, 2 if quick else 3)
    slow, taken = cpu_seconds(lambda: literal_extraction(before, after))
    np.testing.assert_array_equal(extract_changes(before, after).indices, taken)
    fast = medians({"ours": lambda: extract_changes(before, after)}, 11)["ours"]
    yield Ratio(f"{len(taken)} components taken: times faster than linprog", slow / fast, 200)


def rooms(k: int, n_new: int) -> tuple[GaussianMixture, GaussianMixture]:
    """Two fits to one room that cut it slightly differently; the later one has new things, far off."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-1, 1, (k, 3))
    covariances = np.broadcast_to(0.01 * np.eye(3), (k, 3, 3))
    moved = means + rng.normal(0, 0.02, means.shape)
    moved[:n_new] += [3.0, 0.0, 0.0]
    return (
        GaussianMixture(rng.dirichlet(np.full(k, 20.0)), means, covariances),
        GaussianMixture(rng.dirichlet(np.full(k, 20.0)), moved, covariances),
    )


def literal_extraction(before: GaussianMixture, after: GaussianMixture) -> list[int]:
    """Algorithm 1 with every removal solved by SciPy's `linprog`."""
    left, taken = list(range(after.n_components)), []
    cost = mean_distances(before, after)

    def distance(kept: list[int]) -> float:
        return emd(before.weights, after.weights[kept], cost[:, kept], solver="linprog").distance

    here = distance(left)
    while len(left) > 1:
        tried = {k: distance([j for j in left if j != k]) for k in left}
        best = min(tried, key=tried.__getitem__)
        if tried[best] >= here - 1e-9:
            return taken
        here = tried[best]
        left.remove(best)
        taken.append(best)
    return taken
