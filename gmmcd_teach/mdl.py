"""Minimum description length: what a mixture and its points take to tell, in nats (chapter 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.clouds import check_points
from gmmcd_teach.mixture import GaussianMixture, check_mixture


def n_parameters(n_dimensions: int) -> int:
    """P, the numbers that specify one Gaussian: D for its mean and D (D + 1) / 2 for its covariance (Eq. 13).

    Examples
    --------
    >>> n_parameters(3), n_parameters(2)
    (9, 5)
    """
    return n_dimensions + n_dimensions * (n_dimensions + 1) // 2


def mdl_penalty(weights: ArrayLike, n_points: float, n_dimensions: int) -> float:
    """What the parameters cost, in nats: p(k) of Eq. 16 with log(N / 12), as Figueiredo & Jain (2002) have it.

    Components of weight 0 cost nothing.

    Examples
    --------
    >>> round(mdl_penalty([1.0], 12, 3), 6)
    5.0
    """
    alpha = np.asarray(weights, dtype=np.float64)
    alpha = alpha[alpha > 0]
    k, p = len(alpha), n_parameters(n_dimensions)
    return float(p / 2 * np.log(n_points * alpha / 12).sum() + k / 2 * np.log(n_points / 12) + k * (p + 1) / 2)


def description_length(mixture: GaussianMixture, points: ArrayLike) -> float:
    """Nats that the mixture and then the points take to tell: penalty minus log-likelihood (Eqs. 15 to 17).

    Raises
    ------
    CloudError
        No mixture; or the points, (N, D) in metres, cannot be used or do not have its dimension.

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[0.0]], [[[1.0]]])
    >>> round(description_length(one, np.zeros((12, 1))), 4)
    12.5273
    """
    s, mixture = check_points(points), check_mixture(mixture, "mixture")
    return mdl_penalty(mixture.weights, len(s), mixture.n_dimensions) - mixture.log_likelihood(s)
