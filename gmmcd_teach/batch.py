"""The batch update: all responsibilities first, then all components at once, as the paper's text has it (chapter 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.features import Blocks, moments, natural_parameters
from gmmcd_teach.mixture import GaussianMixture

REACH = 40.0  # nats: a component whose density lies so far below that of a point has no share in it; exp(-40) = 4e-18
FALLEN = 0.1  # REACH counts from the density before: where that has fallen to this part, all components are asked


def expect(mixture: GaussianMixture, blocks: Blocks) -> tuple[float, Floats]:
    """The E-step: log-likelihood (Eq. 4), and the (K, F) sums of w_ik times features (Eqs. 6 and 7).

    Densities are relative to those of the E-step before. Below exp(-700) one is as good as none,
    and slow to compute. Where that of a point has fallen or risen far, the reference was too old:
    its block is visited again, with all components, relative to the largest term, as log-sum-exp
    does.
    """
    features, counts = blocks.features, blocks.counts  # (M, F + 1, B), (M, B)
    k, (m, f, size) = mixture.n_components, features.shape
    eta = np.column_stack([natural_parameters(mixture), np.ones(k)])  # 1: for the reference
    total = np.empty_like(counts)  # densities of the points, relative to the E-step before
    sums = np.zeros((m, k, f - 1))  # of each block
    space, ones = np.empty((k, size)), np.ones(k)  # for all blocks: fresh memory is slow

    def visit(block: int, near: NDArray[np.intp]) -> None:
        phi, density = features[block], space[: len(near)]  # (F + 1, B), (K', B)
        np.matmul(eta[near], phi, out=density)
        density.clip(-700.0, np.inf, out=density)  # np.maximum is slower with a number
        np.exp(density, out=density)
        np.matmul(ones[: len(near)], density, out=total[block])
        density *= counts[block] / total[block]  # w_ik, as often as the point counts
        sums[block, near] = density @ phi[:-1].T

    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        for block, near in enumerate(within_reach(mixture, blocks)):
            visit(block, near)
        too_old = (total.min(axis=1) < FALLEN) | (total.max(axis=1) > 1e100)  # (M,)
        for block in too_old.nonzero()[0]:
            features[block, -1] = 0.0
            features[block, -1] = -np.matmul(eta, features[block], out=space).max(axis=0)
            visit(block, np.arange(k))
    features[:, -1] -= np.log(total, out=total)
    return -float((features[:, -1] * counts).sum()), sums.sum(axis=0)


def within_reach(mixture: GaussianMixture, blocks: Blocks, reach: float = REACH) -> list[NDArray[np.intp]]:
    """For each block the components that may come within `reach` nats of the density of one of its points.

    Along the axes on which a component is round, z = W (s - mu), the box of a block covers an
    interval each. The nearest ends give a distance that no point of the block can be below. One
    block holds all points: all are needed.
    """
    if len(blocks.features) == 1:
        return [np.arange(mixture.n_components)]
    factors, peak = mixture.whitening
    centres = (factors @ mixture.means[:, :, None]).reshape(-1, 1)  # (K D, 1)
    axes = factors.reshape(len(centres), -1)  # (K D, D)
    away = np.abs(axes @ blocks.centres.T - centres)  # (K D, M)
    away -= np.abs(axes) @ blocks.reaches.T
    outside = np.maximum(0.0, away).reshape(len(peak), -1, len(blocks.centres))  # (K, D, M)
    log_joint = peak[:, None] - 0.5 * (outside**2).sum(axis=1)  # (K, M), or less
    least = -blocks.features[:, -1].max(axis=1)  # (M,)
    return [near.nonzero()[0] for near in (log_joint >= least - reach).T]


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
    support = np.maximum(support, np.finfo(float).tiny)  # without a point, and yet alive where all must live
    if len(support) <= min_components:
        return support
    weights = np.maximum(0.0, support - penalty)
    if np.count_nonzero(weights) < min_components:
        weights = np.where(np.arange(len(support)) == support.argmin(), 0.0, support)
    return weights
