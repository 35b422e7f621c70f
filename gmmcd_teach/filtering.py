"""Clean and thin a cloud: statistical outlier removal and the voxel grid, as in PCL (chapter 2)."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from gmmcd_teach.clouds import CloudError, Floats, check_points

QUERY_BLOCK = 20_000  # points asked of the tree at once: its answer has n_neighbors columns
TABLE_CELLS, TABLE_SPARSITY = 1 << 24, 64  # a grid of at most so many cells, and cells per point, is kept as a table


def statistical_outlier_mask(points: ArrayLike, n_neighbors: int = 50, std_ratio: float = 1.0) -> NDArray[np.bool_]:
    """Return which points to keep, (N,) bool: those whose neighbours are not unusually far.

    A point stays if its mean distance to its `n_neighbors` nearest others is at most the mean of that number over the
    cloud plus `std_ratio` sample standard deviations (Rusu et al. 2008, as PCL's StatisticalOutlierRemoval counts).

    Parameters
    ----------
    points : (N, D) metres, N > n_neighbors.
    n_neighbors : k, how many other points to look at; at least 1.
    std_ratio : how many standard deviations above the mean are still usual; at least 0.

    Raises
    ------
    CloudError
        The points are unfit, or no more than `n_neighbors`.
    ValueError
        An option is out of range.

    Examples
    --------
    >>> line = np.column_stack([np.arange(6.0), np.zeros(6)])
    >>> statistical_outlier_mask(np.vstack([line, [[9.0, 9.0]]]), n_neighbors=2)
    array([ True,  True,  True,  True,  True,  True, False])
    """
    if not (isinstance(n_neighbors, Integral) and n_neighbors >= 1):
        raise ValueError(f"n_neighbors is {n_neighbors!r}; expected an integer of at least 1")
    if not (isinstance(std_ratio, Real) and 0 <= std_ratio < np.inf):
        raise ValueError(f"std_ratio is {std_ratio!r}; expected a finite number of at least 0")
    points = check_points(points)
    if len(points) <= n_neighbors:
        raise CloudError(f"points: {len(points)} points; n_neighbors = {n_neighbors} others need {n_neighbors + 1}")
    tree = KDTree(points, leafsize=32, balanced_tree=False)
    mean_distances = np.empty(len(points))
    for block in np.array_split(
        tree.indices, -(-len(points) // QUERY_BLOCK)
    ):  # in the tree's order: neighbours together
        distances, _ = tree.query(points[block], n_neighbors + 1, workers=-1)  # (B, k + 1), a zero among them: itself
        mean_distances[block] = distances.sum(axis=1) / n_neighbors
    return mean_distances <= mean_distances.mean() + std_ratio * mean_distances.std(ddof=1)


@dataclass(frozen=True, eq=False)
class Voxels:
    """The occupied cells of a voxel grid, in the order of their position (x, then y, then z).

    Attributes
    ----------
    centroids : (M, D) metres, mean of the points in each cell.
    counts : (M,) int, how many points each cell holds.
    membership : (N,) int, the cell of each point.
    """

    centroids: Floats
    counts: NDArray[np.int64]
    membership: NDArray[np.int64]


def voxel_downsample(points: ArrayLike, leaf_size: float) -> Voxels:
    """Put one point, the centroid, in place of all points in each cell floor(point / leaf_size) of a grid.

    The cells start at multiples of the leaf, as PCL's do (Open3D's start at the cloud's corner). PCL computes in
    float32; float64 gives its published counts too, and keeps cells apart 500 km from the origin, where float32
    cannot tell two points 3 cm apart.

    Parameters
    ----------
    points : (N, D) metres.
    leaf_size : edge of a cell, metres, above 0.

    Raises
    ------
    CloudError
        The points are unfit, or so far out that a cell's number has more digits than a float.
    ValueError
        `leaf_size` is not a positive number.

    Examples
    --------
    >>> voxels = voxel_downsample([[0.1, 0.2], [0.3, 0.2], [-0.1, 0.2]], leaf_size=0.5)
    >>> voxels.centroids
    array([[-0.1,  0.2],
           [ 0.2,  0.2]])
    >>> voxels.membership
    array([1, 1, 0])
    """
    if not (isinstance(leaf_size, Real) and 0 < leaf_size < np.inf):
        raise ValueError(f"leaf_size is {leaf_size!r}; expected a length in metres above 0")
    points = check_points(points)
    columns = points.T.copy()  # (D, N)
    with np.errstate(over="ignore"):
        cells = columns / leaf_size
    np.floor(cells, out=cells)
    if max(cells.max(), -cells.min()) >= 2.0**53:
        raise CloudError(f"points: reach too far for cells of {leaf_size} m; expected a larger leaf, or a nearer cloud")
    membership = _number(cells)
    counts = np.bincount(membership)
    member = np.empty(len(counts), dtype=np.int64)
    member[membership] = np.arange(len(points))  # one point of each cell: offsets from it are small, sums of them exact
    centroids = np.empty((len(counts), len(columns)))
    for d, offset in enumerate(columns):
        start = offset[member]
        offset -= start[membership]
        centroids[:, d] = start + np.bincount(membership, offset) / counts
    return Voxels(centroids, counts, membership)


def _number(cells: Floats) -> NDArray[np.int64]:
    """Number the distinct columns of `cells` (D, N) in lexicographic order, (N,); the cells are written over."""
    cells -= cells.min(axis=1, keepdims=True)
    if not _fit_in_a_key(cells):
        cells[:] = [np.unique(axis, return_inverse=True)[1] for axis in cells]
    if not _fit_in_a_key(cells):  # many dimensions
        return np.unique(cells, axis=1, return_inverse=True)[1].ravel()
    key = cells[0].astype(np.int64)
    for axis in cells[1:]:
        key *= int(axis.max()) + 1
        key += axis.astype(np.int64)
    return _ranks(key)


def _fit_in_a_key(cells: Floats) -> bool:
    """Do the columns of `cells` (D, N), counted from 0, have distinct numbers below 2^62?"""
    return bool(np.prod(cells.max(axis=1) + 1) < 2.0**62)


def _ranks(key: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of each key among the distinct ones, (N,): by a table where that is small enough, else by sorting."""
    if key.max() >= min(TABLE_CELLS, TABLE_SPARSITY * len(key)):
        return np.unique(key, return_inverse=True)[1]
    occupied = np.zeros(key.max() + 1, dtype=bool)
    occupied[key] = True
    occupied_cells = np.flatnonzero(occupied)
    numbers = np.empty(len(occupied), dtype=np.int64)
    numbers[occupied_cells] = np.arange(len(occupied_cells))
    return numbers[key]
