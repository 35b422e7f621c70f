"""A cloud as a surface: how dense it is, thinned to cells, with a normal for each (chapter 16)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from gmmcd_teach.clouds import Floats
from gmmcd_teach.filtering import voxel_downsample

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Surface:
    """The cells of a cloud: centroids (M, 3), unit normals (M, 3), the cell of each point (N,), a tree of centroids."""

    centroids: Floats
    normals: Floats
    membership: NDArray[np.int64]
    tree: KDTree


def nearest(tree: KDTree, points: Floats, k: int = 1, within: float = np.inf) -> tuple[Floats, Indices]:
    """Distances (N, k) and numbers (N, k) of the nearest points of the tree; infinity and M where there are fewer.

    Examples
    --------
    >>> nearest(KDTree([[0.0], [1.0]]), np.array([[0.2]]))[1]
    array([[0]])
    """
    distance, number = tree.query(points, k, distance_upper_bound=within)
    return np.reshape(distance, (len(points), k)), np.reshape(number, (len(points), k)).astype(np.intp)


def point_spacing(points: Floats, n_neighbors: int = 10, n_samples: int = 2000) -> float:
    """Edge in metres of the square of surface that one point stands for: median over every so many points.

    A disc of radius r that holds k neighbours has pi r^2 / k of surface for each. Repeated points count once.

    Examples
    --------
    >>> grid = np.stack(np.meshgrid(np.arange(30.0), np.arange(30.0), [0.0]), -1).reshape(-1, 3)
    >>> 0.8 < point_spacing(grid) < 1.2
    True
    """
    k = min(n_neighbors, len(points) - 1)
    if k < 1:
        return 0.0
    sample = points[:: max(1, len(points) // n_samples)]
    distance = nearest(KDTree(points), sample, k + 1)[0]
    if (distance[:, 1] == 0).any() and len(once := distinct(points)) < len(points):
        return point_spacing(once, n_neighbors, n_samples)
    return float(np.median(distance[:, -1]) * np.sqrt(np.pi / k))


def distinct(points: Floats) -> Floats:
    """(M, D) the points without those that repeat another, in their order.

    Examples
    --------
    >>> distinct(np.array([[2.0], [1.0], [2.0]])).tolist()
    [[2.0], [1.0]]
    """
    order = np.lexsort(points.T)  # stable: of those that are equal the first stays the first
    repeats = np.zeros(len(points), dtype=bool)
    repeats[order[1:]] = (points[order[1:]] == points[order[:-1]]).all(axis=1)
    return points[~repeats]


def surface_of(points: Floats, leaf_size: float, n_neighbors: int = 12, towards: Floats | None = None) -> Surface:
    """Thin a cloud to cells and give each the normal of the plane through its nearest cells.

    `towards` (N, 3), directions from the points to the sensor, turns each normal to the side that was seen.
    """
    voxels = voxel_downsample(points, leaf_size)
    tree = KDTree(voxels.centroids)
    near = nearest(tree, voxels.centroids, min(n_neighbors, len(voxels.centroids)))[1]
    around = voxels.centroids[near]  # (M, k, 3)
    spread = around - around.mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(spread.swapaxes(1, 2) @ spread)[1][:, :, 0]  # (M, 3)
    if towards is not None:
        mean = np.stack([np.bincount(voxels.membership, axis) for axis in towards.T], axis=1)
        normals = np.where((normals * mean).sum(axis=1, keepdims=True) < 0, -normals, normals)
    return Surface(voxels.centroids, normals, voxels.membership, tree)
