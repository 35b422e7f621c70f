"""Exercises of chapter 2: filtering."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Bools = NDArray[np.bool_]


def _sorted_distances(points: Floats) -> Floats:
    return np.sort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)  # (N, N), column 0: the point itself


def neighbour_distance(points: Floats, k: int) -> Floats:
    """(N,) mean distance of each point to its k nearest others, metres."""
    return _sorted_distances(points)[:, 1 : k + 1].mean(axis=1)


def keep(mean_distances: Floats, std_ratio: float) -> Bools:
    """(N,) bool: the rule of statistical outlier removal."""
    limit = mean_distances.mean() + std_ratio * mean_distances.std(ddof=1)
    return np.asarray(mean_distances <= limit)


def voxel_centroids(points: Floats, leaf_size: float) -> Floats:
    """(M, D) mean of the points in each occupied cell floor(point / leaf_size), cells ordered by x, then y, then z."""
    return _centroids(points, np.floor(points / leaf_size))


def _centroids(points: Floats, cells: Floats) -> Floats:
    _, member, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    member = member.ravel()
    return np.column_stack([np.bincount(member, column) for column in points.T]) / counts[:, None]


def _grid(cells: Callable[[Floats, float], Floats]) -> Callable[[Floats, float], Floats]:
    return lambda points, leaf_size: _centroids(points, cells(points, leaf_size))


def _cell_centres(points: Floats, leaf_size: float) -> Floats:
    return (np.unique(np.floor(points / leaf_size), axis=0) + 0.5) * leaf_size


def _first_points(points: Floats, leaf_size: float) -> Floats:
    return points[np.unique(np.floor(points / leaf_size), axis=0, return_index=True)[1]]


def _clouds() -> Iterator[tuple[Floats, int]]:
    return ((np.random.default_rng(seed).normal(size=(12, 3)), 2 + seed) for seed in range(3))


def _means() -> Iterator[tuple[Floats, float]]:
    """In each of the first three lists, the rule and every usual mistake make different choices."""
    yield np.array([0.13, 0.06, 0.11, 0.13, 0.05, 0.05, 0.01, 0.15, 0.05, 0.14, 0.07, 0.04]), 1.5
    yield np.array([0.13, 0.10, 0.03, 0.09, 0.12, 0.05, 0.13, 0.03, 0.02, 0.10, 0.15, 0.11]), 0.5
    yield np.array([0.17, 0.03, 0.03, 0.08, 0.02, 0.06, 0.10, 0.02, 0.11, 0.09, 0.02, 0.03]), 0.8
    yield np.array([1.0, 2.0, 3.0]), 0.0  # the second is at the limit, and kept


def _scattered() -> Iterator[tuple[Floats, float]]:
    return ((np.random.default_rng(seed).uniform(-1, 1, (60, 3)), 0.6) for seed in range(3))


register(
    Exercise(
        "ex-02-1",
        _clouds,
        neighbour_distance,
        (
            Mistake(
                "the point is among its own neighbours, at distance 0: leave it out, and take k others",
                lambda s, k: _sorted_distances(s)[:, :k].mean(axis=1),
            ),
            Mistake(
                "the point itself is one of the k + 1 that you divide by; divide by k",
                lambda s, k: _sorted_distances(s)[:, : k + 1].mean(axis=1),
            ),
            Mistake(
                "that is the distance to the k-th neighbour alone; take the mean over all k",
                lambda s, k: _sorted_distances(s)[:, k],
            ),
            Mistake(
                "these are squared distances; take the square root of each before the mean",
                lambda s, k: (_sorted_distances(s)[:, 1 : k + 1] ** 2).mean(axis=1),
            ),
            Mistake(
                "that is the mean distance to all others; sort the distances and take the k smallest",
                lambda s, k: _sorted_distances(s)[:, 1:].mean(axis=1),
            ),
            Mistake("that is the sum over the neighbours; divide by k", lambda s, k: k * neighbour_distance(s, k)),
        ),
    ),
    Exercise(
        "ex-02-2",
        _means,
        keep,
        (
            Mistake("that is the list of outliers; True shall mean keep", lambda d, r: ~keep(d, r)),
            Mistake(
                "you also drop points in unusually dense places; the rule has one side only, far neighbours",
                lambda d, r: np.abs(d - d.mean()) <= r * d.std(ddof=1),
            ),
            Mistake(
                "that is the standard deviation with divisor N; PCL takes the sample's, with N - 1: ddof=1",
                lambda d, r: d <= d.mean() + r * d.std(),
            ),
            Mistake(
                "you left std_ratio out: it says how many standard deviations are still usual",
                lambda d, r: d <= d.mean() + d.std(ddof=1),
            ),
            Mistake(
                "you took the variance, in square metres; a limit on metres needs the standard deviation",
                lambda d, r: d <= d.mean() + r * d.var(ddof=1),
            ),
            Mistake(
                "a point exactly at the limit stays: <=, not <. On an even grid all points are at the limit",
                lambda d, r: d < d.mean() + r * d.std(ddof=1),
            ),
            Mistake(
                "the limit starts from the median in your rule; PCL's starts from the mean",
                lambda d, r: d <= np.median(d) + r * d.std(ddof=1),
            ),
        ),
    ),
    Exercise(
        "ex-02-3",
        _scattered,
        voxel_centroids,
        (
            Mistake(
                "int() and astype(int) cut towards zero, so the two cells beside 0 become one: use np.floor",
                _grid(lambda s, leaf: np.trunc(s / leaf)),
            ),
            Mistake(
                "rounding shifts the grid by half a cell; a cell begins at a multiple of the leaf: use np.floor",
                _grid(lambda s, leaf: np.rint(s / leaf)),
            ),
            Mistake(
                "your grid starts at the smallest point, so two clouds of one room get different cells; start it at 0",
                _grid(lambda s, leaf: np.floor((s - s.min(axis=0)) / leaf)),
            ),
            Mistake(
                "that is Open3D's grid, half a leaf before the smallest point; PCL's starts at multiples of the leaf",
                _grid(lambda s, leaf: np.floor((s - s.min(axis=0)) / leaf + 0.5)),
            ),
            Mistake("these are the centres of the cells; take the mean of the points in each", _cell_centres),
            Mistake("that is one point of each cell; take the mean of all that are in it", _first_points),
            Mistake(
                "you multiplied by the leaf; how many leaves fit into a coordinate is a division",
                _grid(lambda s, leaf: np.floor(s * leaf)),
            ),
        ),
    ),
)
