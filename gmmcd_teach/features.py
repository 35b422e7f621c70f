"""The quadratic features of points, in which the logarithm of a Gaussian is linear (chapters 5 and 13)."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import CloudError, Floats
from gmmcd_teach.mixture import GaussianMixture

BLOCK = 5_000  # most points worked on at a time: with fewer, the calls from Python weigh
DENSITIES = 125_000  # most densities of a block, 1 MB: with more, they leave the cache of a core


class Blocks(NamedTuple):
    """The points as EM sees them, in M blocks of B neighbours, components and features as rows.

    Attributes
    ----------
    features : (M, F + 1, B) the features of the points; the last row is minus their log-density of the E-step before,
        so that a product with it gives log-densities relative to that, which the exponential can take as they are.
    counts : (M, B) how many points each column stands for; 0 for those that fill up the last places.
    centres, reaches : (M, D) the boxes around the points of each block, and half of their edges.
    """

    features: Floats
    counts: Floats
    centres: Floats
    reaches: Floats


def block_size(n_components: int) -> int:
    """Most points of a block, for so many components.

    Examples
    --------
    >>> [block_size(k) for k in (5, 25, 50)]
    [5000, 5000, 2500]
    """
    return max(1, min(BLOCK, DENSITIES // n_components))


@cache
def pairs(n_dimensions: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The rows and columns i <= j of a symmetric matrix, in the order in which the features x_i x_j stand.

    Examples
    --------
    >>> [index.tolist() for index in pairs(2)]
    [[0, 0, 1], [0, 1, 1]]
    """
    return np.triu_indices(n_dimensions)


@cache
def places(n_dimensions: int) -> NDArray[np.intp]:
    """(D, D) which of the features is x_i x_j.

    Examples
    --------
    >>> places(2).tolist()
    [[3, 4], [4, 5]]
    """
    i, j = pairs(n_dimensions)
    table = np.empty((n_dimensions, n_dimensions), dtype=np.intp)
    table[i, j] = table[j, i] = 1 + n_dimensions + np.arange(len(i))
    return table


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


def blocks_of(features: Floats, counts: Floats, size: int = BLOCK) -> Blocks:
    """(F, N) features and their (N,) counts in blocks of at most `size`, with a reference of 0 to begin with.

    Examples
    --------
    >>> blocks = blocks_of(quadratic_features(np.array([[5.0], [1.0], [4.0]])), np.ones(3), size=2)
    >>> blocks.features.shape, blocks.centres.ravel().tolist(), blocks.reaches.ravel().tolist()
    ((2, 4, 2), [2.5, 4.5], [1.5, 0.5])
    """
    f, n = features.shape
    halvings = max(0, math.ceil(math.log2(n / size)))
    places = -(-n // 2**halvings) * 2**halvings  # the last point again, counted 0 times, fills up
    order = neighbourhoods(np.pad(features[1 : 1 + dimensions(f)], ((0, 0), (0, places - n)), "edge"), halvings)
    of_blocks = np.zeros((len(order), f + 1, order.shape[1]))
    of_blocks[:, :-1] = features[:, np.minimum(order, n - 1)].swapaxes(0, 1)
    points = of_blocks[:, 1 : 1 + dimensions(f)]  # (M, D, B)
    low, high = points.min(axis=2), points.max(axis=2)
    return Blocks(of_blocks, np.pad(counts, (0, places - n))[order], (low + high) / 2, (high - low) / 2)


def neighbourhoods(points: Floats, halvings: int) -> NDArray[np.intp]:
    """(M, B) indices of (D, N) points, halved again and again along the longest edge of their box; N = M B.

    Examples
    --------
    >>> neighbourhoods(np.array([[0.0, 9.0, 0.1, 8.0], [5.0, 5.1, 5.2, 5.3]]), 1).tolist()
    [[0, 2], [3, 1]]
    """
    order = np.arange(points.shape[1])[None]
    for _ in range(halvings):
        x = points[:, order]  # (D, M, B)
        x = x[np.ptp(x, axis=2).argmax(axis=0), np.arange(len(order))]  # (M, B) the coordinate that varies most
        middle = order.shape[1] // 2
        order = np.take_along_axis(order, np.argpartition(x, middle, axis=1), axis=1).reshape(-1, middle)
    return order


def dimensions(n_features: int) -> int:
    """D of points with F = (D + 1) (D + 2) / 2 features.

    Examples
    --------
    >>> dimensions(6), dimensions(10)
    (2, 3)
    """
    return int(np.sqrt(2 * n_features + 0.25) - 1.5)


def average_over_cells(points: Floats, features: Floats, counts: Floats, cell_size: float) -> tuple[Floats, Floats]:
    """(F, M) mean features and (M,) counts of the M occupied cubes of edge `cell_size`.

    A cube's mean features hold its mean and its second moment, so sums over cubes equal sums over points wherever all
    points of a cube have the same responsibilities (Verbeek, Nunnink & Vlassis 2006).

    Raises
    ------
    CloudError
        The cubes are too small to be numbered.

    Examples
    --------
    >>> x = np.array([[0.1], [0.3], [1.5]])
    >>> average_over_cells(x, quadratic_features(x), np.ones(3), 1.0)[0].round(2).tolist()
    [[1.0, 1.0], [0.2, 1.5], [0.05, 2.25]]
    """
    steps = np.floor((points - points.min(axis=0)) / cell_size)
    if np.log2(steps.max(axis=0) + 1).sum() > 53:  # beyond, a float no longer counts in ones
        raise CloudError(f"cell_size = {cell_size}: too many cells between the farthest points; take larger cells")
    _, member = np.unique(
        np.ravel_multi_index(steps.astype(np.int64).T, (steps.max(axis=0) + 1).astype(np.int64)), return_inverse=True
    )
    total = np.asarray(np.bincount(member, counts), dtype=np.float64)  # (M,)
    kept = total > 0
    return np.stack([np.bincount(member, counts * row)[kept] for row in features]) / total[kept], total[kept]


def natural_parameters(mixture: GaussianMixture) -> Floats:
    """(K, F) coefficients eta with log alpha_k + log p(s | theta_k) = eta_k times features(s).

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[2.0]], [[[1.0]]])
    >>> abs((natural_parameters(one) @ quadratic_features(np.array([[2.0]])) + np.log(2 * np.pi) / 2).item()) < 1e-15
    True
    """
    i, j = pairs(mixture.n_dimensions)
    factors, peak = mixture.whitening
    precisions = factors.swapaxes(1, 2) @ factors  # (K, D, D) Sigma^-1
    linear = (precisions @ mixture.means[:, :, None])[:, :, 0]  # (K, D)
    constant = peak - 0.5 * (linear * mixture.means).sum(axis=1)
    return np.column_stack([constant, linear, precisions[:, i, j] * np.where(i == j, -0.5, -1.0)])


def moments(sums: Floats, covariance_floor: float) -> tuple[Floats, Floats, Floats]:
    """Support (K,), means (K, D) and covariances (K, D, D) from (K, F) sums of w_ik times features (Eqs. 9 and 10).

    A covariance is a difference of squares. Where rounding could have eaten it, a CloudError says so; and where a
    component that must live has no points, as one of a given start may.

    Examples
    --------
    >>> support, means, covariances = moments(np.array([[4.0, 8.0, 20.0]]), 0.0)
    >>> float(support[0]), float(means[0, 0]), float(covariances[0, 0, 0])
    (4.0, 2.0, 1.0)
    """
    support = sums[:, 0]
    if support.min() < 1e-200:
        raise CloudError("a component has no points; lower min_components, or leave it out of init")
    d = dimensions(sums.shape[1])
    average = sums / support[:, None]  # (K, F) of the features, over the points of a component
    means, squares = average[:, 1 : 1 + d], average[:, places(d)]
    covariances = squares - means[:, :, None] * means[:, None, :] + covariance_floor * np.eye(d)
    lost = 16 * np.finfo(float).eps * np.trace(squares, axis1=1, axis2=2)  # (K,) to rounding, of mean squared distances
    if covariance_floor <= 100 * lost.max():  # above, no eigenvalue can come near to what is lost
        smallest = np.linalg.eigvalsh(covariances)[:, 0]  # (K,)
        if (smallest <= lost).any():
            k = int((smallest - lost).argmin())
            raise CloudError(
                f"covariance of component {k}: flat, its smallest eigenvalue {smallest[k]:.3g} m^2 is lost in "
                "rounding; raise covariance_floor"
            )
    return support, means, covariances
