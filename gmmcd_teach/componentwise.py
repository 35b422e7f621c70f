"""The component-wise update (CEM2): one component after the other, each seeing the last one's change (chapter 6).

Celeux, Chretien, Forbes & Mkhadri (2001), as used by Figueiredo & Jain (2002) and by the paper's published code.
"""

from __future__ import annotations

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.features import Blocks, moments, natural_parameters
from gmmcd_teach.mixture import GaussianMixture


def expect(mixture: GaussianMixture, blocks: Blocks) -> tuple[float, Floats]:
    """Log-likelihood (Eq. 4), and (F + 1, N) features whose last row takes off each point's log-density (`Blocks`)."""
    features, counts = np.hstack(tuple(blocks.features)), blocks.counts.ravel()  # (F + 1, N), (N,)
    log_joint = natural_parameters(mixture) @ features[:-1]  # (K, N)
    top = log_joint.max(axis=0)
    log_density = top + np.log(np.exp(np.maximum(log_joint - top, -700.0)).sum(axis=0))
    features[-1] = -log_density
    return float(counts @ log_density), features


def maximise(
    mixture: GaussianMixture, features: Floats, blocks: Blocks, min_components: int, covariance_floor: float
) -> GaussianMixture:
    """One sweep: for each component its own E-step (Eq. 7) and M-step (Eqs. 9 to 11) before the next one's turn.

    The share of a component is its weight of Eq. 11. Components too weak to live count in full until their own turn, so
    that they die one by one and those that remain can take over their points. While all have more than P / 2 points,
    no turn lets the penalised cost (Eq. 17) rise.
    """
    counts = blocks.counts.ravel()
    alpha, means, covariances = (a.copy() for a in (mixture.weights, mixture.means, mixture.covariances))
    density = component_densities(means, covariances, features)  # (K, N), without the weights
    k = 0
    while k < len(alpha):
        penalty = (len(features) - 2) / 2 if len(alpha) > min_components else 0.0  # P / 2
        total = alpha @ density  # (N,)
        if total.min() < 1e-100 or total.max() > 1e100:  # a component left some points: their reference is too old
            features = expect(GaussianMixture(alpha, means, covariances), blocks)[1]
            density = component_densities(means, covariances, features)
            total = alpha @ density
        support = alpha * (density @ (counts / total))  # (K,)
        if len(alpha) > min_components and support[k] <= penalty:
            alpha, means, covariances, density = (np.delete(a, k, axis=0) for a in (alpha, means, covariances, density))
            alpha /= alpha.sum()
            continue
        w = alpha[k] * density[k] * (counts / total)  # (N,) responsibilities of component k
        _, mean, covariance = moments((features[:-1] @ w)[None], covariance_floor)
        claims = np.where(support > penalty, support - penalty, support)  # (K,)
        others = np.arange(len(alpha)) != k
        alpha[others] *= (1 - claims[k] / claims.sum()) / (alpha[others].sum() or 1.0)  # they keep their proportions
        alpha[k] = claims[k] / claims.sum()
        means[k], covariances[k] = mean[0], covariance[0]
        density[k] = component_densities(mean, covariance, features)[0]
        k += 1
    return GaussianMixture(alpha / alpha.sum(), means, covariances)


def component_densities(means: Floats, covariances: Floats, features: Floats) -> Floats:
    """(K, N) p(s_i | theta_k) relative to the density in the features' last row, held within the range of floats."""
    k = len(means)
    each = GaussianMixture(np.full(k, 1 / k), means, covariances)
    eta = np.column_stack([natural_parameters(each), np.ones(k)])
    eta[:, 0] += np.log(k)  # take the equal weights out again
    return np.exp(np.clip(eta @ features, -700.0, 700.0))
