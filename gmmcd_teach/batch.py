"""The batch update: all responsibilities first, then all components at once, as the paper's text has it (chapter 5)."""

from __future__ import annotations

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.features import Block, moments, natural_parameters
from gmmcd_teach.mixture import BLOCK, GaussianMixture


def expect(mixture: GaussianMixture, blocks: list[Block]) -> tuple[float, Floats]:
    """The E-step: log-likelihood (Eq. 4), and the (K, F) sums over points of w_ik times features (Eqs. 6 and 7).

    Dividing the few features of a point by its density, instead of its K densities, makes them responsibilities. Where
    densities may have left the range of the numbers, the reference was too old: it is taken anew from the largest
    term, as log-sum-exp does.
    """
    k = mixture.n_components
    eta = np.column_stack([natural_parameters(mixture), np.ones(k)])  # the last column adds the reference
    sums = np.zeros((k, eta.shape[1] - 1))
    log_likelihood = 0.0
    space, lowest = np.empty((2, k, BLOCK))  # for each block again: fresh memory costs more than the arithmetic
    lowest[:] = -700.0
    with np.errstate(over="ignore"):
        for features, counts in blocks:
            here = slice(len(counts))
            density, total = relative_density(eta, features, space[:, here], lowest[:, here])
            change = np.log(total)  # of each point's log-density since the E-step before
            if not change @ change < 200**2:
                features[-1] = -(eta[:, :-1] @ features[:-1]).max(axis=0)
                density, total = relative_density(eta, features, space[:, here], lowest[:, here])
                change = np.log(total)
            features[-1] -= change
            log_likelihood -= features[-1] @ counts
            sums += density @ (features[:-1] * (counts / total)).T
    return float(log_likelihood), sums


def relative_density(eta: Floats, features: Floats, space: Floats, lowest: Floats) -> tuple[Floats, Floats]:
    """(K, B) alpha_k p(s_i | theta_k) relative to the reference in the last row of the features, and (B,) their sum.

    The densities are written into `space`. Below exp(-700) a density is as good as none, and slow to compute.
    """
    np.matmul(eta, features, out=space)
    np.maximum(space, lowest, out=space)
    density = np.exp(space, out=space)
    return density, np.ones(len(eta)) @ density


def maximise(
    mixture: GaussianMixture, sums: Floats, blocks: list[Block], min_components: int, covariance_floor: float
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
