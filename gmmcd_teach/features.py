"""The quadratic features of points, in which the logarithm of a Gaussian is linear (chapters 5 and 13)."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import CloudError, Floats
from gmmcd_teach.mixture import GaussianMixture

CACHE = 40_000  # numbers: the K x B densities of a block of B points, which the processor's cache can hold
WIDEST = 4_000  # points in a block: their features have to fit, too


class Blocks(NamedTuple):
    """The points as EM sees them, components and features as rows, worked on in blocks of columns.

    Attributes
    ----------
    features : (F + 1, N) the features of N points; the last row is minus their log-density of the E-step before,
        so that a product with it gives log-densities relative to that, which the exponential can take as they are.
    counts : (N,) how many points each column stands for.
    """

    features: Floats
    counts: Floats

    def cuts(self, n_components: int) -> list[slice]:
        """The columns of each block, as many as fit for so many components."""
        size = block_size(n_components)
        return [slice(start, min(start + size, len(self.counts))) for start in range(0, len(self.counts), size)]


def block_size(n_components: int) -> int:
    """B, the points in a block.

    Examples
    --------
    >>> block_size(1), block_size(25), block_size(50)
    (4000, 1600, 800)
    """
    return min(WIDEST, max(1, CACHE // n_components))


@cache
def pairs(n_dimensions: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows and columns i <= j of a symmetric matrix, in the order in which the features x_i x_j stand.

    Examples
    --------
    >>> [index.tolist() for index in pairs(2)]
    [[0, 0, 1], [0, 1, 1]]
    """
    return np.triu_indices(n_dimensions)


def quadratic_features(points: Floats) -> Floats:
    """(F, N) rows 1, x_i, x_i x_j with i <= j: all that a Gaussian asks of a point; F = 1 + P.

    Examples
    --------
    >>> quadratic_features(np.array([[2.0, 3.0]]))[:, 0]
    array([1., 2., 3., 4., 6., 9.])
    """
    n, d = points.shape
    i, j = pairs(d)
    x = np.ascontiguousarray(points.T)
    return np.concatenate([np.ones((1, n)), x, x[i] * x[j]])


def blocks_of(features: Floats, counts: Floats) -> Blocks:
    """(F, N) features and their (N,) counts, with a reference of 0 to begin with.

    Examples
    --------
    >>> blocks = blocks_of(np.ones((6, 2000)), np.ones(2000))
    >>> blocks.features.shape, blocks.cuts(25)
    ((7, 2000), [slice(0, 1600, None), slice(1600, 2000, None)])
    """
    return Blocks(np.concatenate([features, np.zeros((1, len(counts)))]), counts)


def average_over_cells(points: Floats, features: Floats, counts: Floats, cell_size: float) -> tuple[Floats, Floats]:
    """(F, M) mean features and (M,) counts of the M occupied cubes of edge `cell_size`.

    A cube's mean features hold its mean and its second moment, so sums over cubes equal sums over points wherever all
    points of a cube have the same responsibilities (Verbeek, Nunnink & Vlassis 2006).

    Examples
    --------
    >>> x = np.array([[0.1], [0.3], [1.5]])
    >>> average_over_cells(x, quadratic_features(x), np.ones(3), 1.0)[0].round(2).tolist()
    [[1.0, 1.0], [0.2, 1.5], [0.05, 2.25]]
    """
    steps = np.floor((points - points.min(axis=0)) / cell_size)
    if np.log2(steps.max(axis=0) + 1).sum() > 62:
        raise CloudError(f"cell_size = {cell_size}: too many cells between the farthest points; take larger cells")
    _, member = np.unique(
        np.ravel_multi_index(steps.astype(np.int64).T, (steps.max(axis=0) + 1).astype(np.int64)), return_inverse=True
    )
    total = np.asarray(np.bincount(member, counts), dtype=np.float64)  # (M,)
    kept = total > 0
    return np.stack([np.bincount(member, counts * row)[kept] for row in features]) / total[kept], total[kept]


def natural_parameters(mixture: GaussianMixture) -> Floats:
    """(K, F) coefficients eta with log alpha_k + log p(s | theta_k) = eta_k . features(s).

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[2.0]], [[[1.0]]])
    >>> abs((natural_parameters(one) @ quadratic_features(np.array([[2.0]])) + np.log(2 * np.pi) / 2).item()) < 1e-15
    True
    """
    d = mixture.n_dimensions
    i, j = pairs(d)
    factors = np.linalg.inv(np.linalg.cholesky(mixture.covariances))  # (K, D, D)
    precisions = factors.swapaxes(1, 2) @ factors  # Sigma^-1
    linear = (precisions @ mixture.means[:, :, None])[:, :, 0]  # (K, D)
    half_log_det = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
    constant = (
        np.log(mixture.weights) + half_log_det - d / 2 * np.log(2 * np.pi) - 0.5 * (linear * mixture.means).sum(axis=1)
    )
    return np.column_stack([constant, linear, precisions[:, i, j] * np.where(i == j, -0.5, -1.0)])


def moments(sums: Floats, covariance_floor: float) -> tuple[Floats, Floats, Floats]:
    """Support (K,), means (K, D) and covariances (K, D, D) from (K, F) sums of w_ik times features (Eqs. 9 and 10).

    A covariance is a difference of squares. Where rounding could have eaten it, a CloudError says so.

    Examples
    --------
    >>> support, means, covariances = moments(np.array([[4.0, 8.0, 20.0]]), 0.0)
    >>> float(support[0]), float(means[0, 0]), float(covariances[0, 0, 0])
    (4.0, 2.0, 1.0)
    """
    support = sums[:, 0]
    d = int(np.sqrt(2 * sums.shape[1] + 0.25) - 1.5)  # F = (D + 1) (D + 2) / 2
    i, j = pairs(d)
    means = sums[:, 1 : 1 + d] / support[:, None]
    upper = sums[:, 1 + d :] / support[:, None] - means[:, i] * means[:, j]
    covariances = np.empty((len(sums), d, d))
    covariances[:, i, j] = covariances[:, j, i] = upper
    covariances += covariance_floor * np.eye(d)
    smallest = np.linalg.eigvalsh(covariances)[:, 0]  # (K,)
    squares = sums[:, 1 + d :][:, i == j].sum(axis=1) / support  # (K,) mean squared distance from the origin
    if (smallest <= 16 * np.finfo(float).eps * squares).any():
        k = int((smallest - 16 * np.finfo(float).eps * squares).argmin())
        raise CloudError(
            f"covariance of component {k}: flat, its smallest eigenvalue {smallest[k]:.3g} m^2 is lost in rounding; "
            "raise covariance_floor"
        )
    return support, means, covariances
