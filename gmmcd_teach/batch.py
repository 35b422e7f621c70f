"""The batch update: all responsibilities first, then all components at once, as the paper's text has it (chapter 5)."""

from __future__ import annotations

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.features import Blocks, block_size, moments, natural_parameters
from gmmcd_teach.mixture import GaussianMixture


def expect(mixture: GaussianMixture, blocks: Blocks) -> tuple[float, Floats]:
    """The E-step: log-likelihood (Eq. 4), and the (K, F) sums over points of w_ik times features (Eqs. 6 and 7).

    Dividing the few features of a point by its density, instead of its K densities, makes them responsibilities. Below
    exp(-700) a density is as good as none, and slow to compute. Where a point's density has left the range of the
    numbers, its reference was too old: all are taken anew from the largest term, as log-sum-exp does.
    """
    features, counts = blocks
    k, size = mixture.n_components, block_size(mixture.n_components)
    eta = np.column_stack([natural_parameters(mixture), np.ones(k)])  # the last column adds the reference
    sums = np.zeros((k, len(features) - 1))
    total = np.empty(len(counts))  # densities of the points, relative to the E-step before
    space, lowest = np.empty((2, k, size))  # for each block again: fresh memory costs more than the arithmetic
    lowest[:] = -700.0
    ones = np.ones(k)
    with np.errstate(over="ignore", invalid="ignore"):
        for cut in blocks.cuts(k):
            phi, density = features[:, cut], space[:, : cut.stop - cut.start]  # (F + 1, B), (K, B)
            np.matmul(eta, phi, out=density)
            np.maximum(density, lowest[:, : density.shape[1]], out=density)
            np.exp(density, out=density)
            np.matmul(ones, density, out=total[cut])
            sums += density @ (phi[:-1] * (counts[cut] / total[cut])).T
    if total.min() < 1e-100 or total.max() > 1e100:
        for cut in blocks.cuts(k):
            features[-1, cut] = -(eta[:, :-1] @ features[:-1, cut]).max(axis=0)
        return expect(mixture, blocks)
    features[-1] -= np.log(total, out=total)
    return -float(features[-1] @ counts), sums


def maximise(
    mixture: GaussianMixture, sums: Floats, blocks: Blocks, min_components: int, covariance_floor: float
) -> GaussianMixture:
    """The modified M-step: means and covariances (Eqs. 8 to 10), and weights that annihilate the weak (Eqs. 11 and 12).

    A component that fewer than P / 2 points support dies. Where that would leave fewer than min_components, as when
    all die at once, only the weakest goes; at min_components none, and the M-step is the plain one.
    """
    weights = modified_weights(sums[:, 0], (sums.shape[1] - 1) / 2, min_components)
    alive = weights > 0
    _, means, covariances = moments(sums[alive], covariance_floor)
    return GaussianMixture(weights[alive] / weights.sum(), means, covariances)


def modified_weights(support: Floats, penalty: float, min_components: int) -> Floats:
    """(K,) alpha before normalisation, 0 for the dead: max(0, support - P / 2) of Eq. 11.

    Examples
    --------
    >>> modified_weights(np.array([10.0, 3.0, 7.0]), 4.5, 1)
    array([5.5, 0. , 2.5])
    >>> modified_weights(np.array([4.0, 3.0, 2.0]), 4.5, 1)
    array([4., 3., 0.])
    >>> modified_weights(np.array([10.0, 3.0]), 4.5, 2)
    array([10.,  3.])
    """
    if len(support) <= min_components:
        return support
    weights = np.maximum(0.0, support - penalty)
    if np.count_nonzero(weights) < min_components:
        weights = np.where(np.arange(len(support)) == support.argmin(), 0.0, support)
    return weights
