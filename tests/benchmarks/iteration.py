"""One EM iteration, E-step and M-step, beside scikit-learn's and beside the two products and the exp alone."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture as ScikitMixture

from gmmcd_teach import GaussianMixture, batch, fit_mixture
from gmmcd_teach.features import block_size, blocks_of, natural_parameters, quadratic_features
from tests.benchmarks.timing import Ratio, lab_cloud, medians

SIZES = ((38_528, 25, 15), (38_528, 50, 11), (1_000_000, 25, 3))
IN_A_ROW = 5  # iterations, as in a fit
BLOCKS = (512, 1024, 1600, 2048, 4096)  # of the floor; the best counts
STEPS = 60  # from a random start to the mixture of the iteration: most steps of a path are taken near the end


def measure(quick: bool) -> Iterator[Ratio]:
    """A line for scikit-learn and one for the floor, at each size."""
    for n_points, k, repeats in ((2_000, 5, 2),) if quick else SIZES:
        points = lab_cloud(n_points)
        points -= np.median(points, axis=0)
        mixture = fit_mixture(points, k, k, tol=0, max_iter=STEPS).mixture
        seconds = medians(
            {"ours": ours(mixture, points), "scikit-learn": scikit(k, points)}
            | {f"floor {size}": floor(mixture, points, size) for size in BLOCKS},
            repeats,
            in_a_row=IN_A_ROW if n_points < 100_000 else 1,  # a million points leave all caches anyway
        )
        lowest = min(seconds[f"floor {size}"] for size in BLOCKS)
        named = f"N = {n_points:,}, K = {k}"
        yield Ratio(f"{named}: times faster than scikit-learn", seconds["scikit-learn"] / seconds["ours"], 25)
        yield Ratio(f"{named}: times the floor", seconds["ours"] / lowest, 1.25, at_most=True)


def ours(mixture: GaussianMixture, points: np.ndarray) -> Callable[[], Any]:
    """E-step and M-step as `fit_mixture` calls them."""
    blocks = blocks_of(quadratic_features(points), np.ones(len(points)), block_size(mixture.n_components))

    def iteration() -> GaussianMixture:
        _, sums = batch.expect(mixture, blocks)
        return batch.maximise(mixture, sums, blocks, 1, 1e-6)

    return iteration


def scikit(n_components: int, points: np.ndarray) -> Callable[[], Any]:
    """What scikit-learn's `fit` does in one iteration, without what it does before and after."""
    model = ScikitMixture(n_components, max_iter=1, init_params="random_from_data", random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(points)

    def iteration() -> None:
        _, log_responsibilities = model._e_step(points)
        model._m_step(points, log_responsibilities)

    return iteration


def floor(mixture: GaussianMixture, points: np.ndarray, size: int) -> Callable[[], Any]:
    """The two matrix products and the exp, into memory that is there. Coefficients are small: no exp underflows."""
    features = quadratic_features(points)
    cut = [np.ascontiguousarray(features[:, i : i + size]) for i in range(0, len(points), size)]
    eta = 1e-3 * natural_parameters(mixture)
    space = np.empty((len(eta), size))

    def products() -> np.ndarray:
        sums = np.zeros_like(eta)
        for phi in cut:
            density = space[:, : phi.shape[1]]
            np.exp(np.matmul(eta, phi, out=density), out=density)
            sums += density @ phi.T
        return sums

    return products
