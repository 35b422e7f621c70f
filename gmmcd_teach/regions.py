"""From changed points to things: the connected groups of points that appeared or disappeared (chapter 18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gmmcd_teach.beyond.baselines import check_lengths, check_sizes
from gmmcd_teach.beyond.surface import distinct, point_spacing
from gmmcd_teach.beyond.visibility import check_origin, looks_from
from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.starts import check_number

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Region:
    """One connected group of changed points.

    Attributes
    ----------
    n_points : how many points.
    center : (x, y, z) metres, middle of the box around them.
    size : (x, y, z) metres, edges of that box.
    confidence : share of its points that the other scan contradicts, 0 to 1; None where that was not asked.
    """

    n_points: int
    center: tuple[float, ...]
    size: tuple[float, ...]
    confidence: float | None = None


def find_regions(
    points: ArrayLike, reach: float | None = None, smallest: int = 10, *, contradicted: ArrayLike | None = None
) -> list[Region]:
    """Groups of points that hang together, the largest first.

    Parameters
    ----------
    points : (N, D) changed points, metres; N may be 0.
    reach : metres: points hang together when they lie in the same cube of this edge, or in cubes that touch; None takes
        three times their median spacing, repeated points left out.
    smallest : groups of fewer points are left out.
    contradicted : (N,) bool, see `contradicted_by`; the share in a group is its confidence.

    Raises
    ------
    CloudError
        The points are not (N, D) finite numbers, or `contradicted` is not (N,) bool.
    ValueError
        `reach` is no length above 0, or `smallest` no whole number.

    Examples
    --------
    >>> grid = np.stack(np.meshgrid(*[np.arange(5) / 100] * 3), axis=-1).reshape(-1, 3)
    >>> [region.n_points for region in find_regions(np.concatenate([grid, grid[:50] + 1]))]
    [125, 50]
    """
    s = check_points(points, "changed points", minimum=0)
    votes = None if contradicted is None else np.asarray(contradicted)
    if votes is not None and (votes.shape != (len(s),) or votes.dtype != bool):
        raise CloudError(f"contradicted: {votes.dtype} of shape {votes.shape}; expected bool of shape ({len(s)},)")
    check_sizes(reach=reach)
    check_number("smallest", smallest, 0, whole=True)
    if len(s) < max(2, smallest):
        return [_region(s, votes)] if len(s) >= smallest and len(s) else []
    if reach is None:
        once = distinct(s)
        spacing = np.asarray(cKDTree(once).query(once, k=min(2, len(once)))[0]).reshape(len(once), -1)[:, -1]
        reach = 3 * float(np.median(spacing)) or 0.01
    group = connected_groups(s, reach)
    order = np.argsort(group, kind="stable")
    chunks = np.split(order, np.cumsum(np.bincount(group))[:-1])
    found = [_region(s[chunk], None if votes is None else votes[chunk]) for chunk in chunks if len(chunk) >= smallest]
    return sorted(found, key=lambda region: -region.n_points)


def connected_groups(points: Floats, reach: float) -> NDArray[np.intp]:
    """Number of the group of each point, (N,): the same in one cube of edge `reach`, or in cubes that touch.

    Examples
    --------
    >>> connected_groups(np.array([[0.0], [1.0], [9.0], [2.0]]), 1.0)
    array([0, 0, 1, 0])
    """
    cubes, member = np.unique(np.floor(points / reach), axis=0, return_inverse=True)
    pairs = cKDTree(cubes).query_pairs(1.5, p=np.inf, output_type="ndarray")  # (P, 2) cubes that touch
    ones = np.ones(len(pairs), dtype=bool)
    touches = coo_array((ones, pairs.T), shape=(len(cubes), len(cubes)))
    group = connected_components(touches, directed=False)[1]  # of each cube
    return np.asarray(group[member.ravel()], dtype=np.intp)


def contradicted_by(
    points: ArrayLike, other: ArrayLike, *, origin: ArrayLike | None = None, tolerance: float | None = None
) -> Bools:
    """Which points (N, 3) of a scan the `other` scan (M, 3) contradicts, (N,) bool: evidence of its own for a change.

    With `origin` (3,), where the other scan was taken from: the other scan looked past the point, at something farther
    away. Without: nothing of the other scan is near. That is weaker, since nothing is near a surface either that the
    other scan could not see. Near is within `tolerance` metres; None takes three times the spacing of the other scan's
    points or three times the median distance between the two scans, whichever is larger, so that noise and a scan laid
    slightly askew are no evidence; `points` must then be the whole scan.

    Raises
    ------
    CloudError
        A cloud is not (N, 3) finite numbers, or the origin not three of them.
    ValueError
        `tolerance` is no length.

    Examples
    --------
    >>> wall = np.stack(np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50), [2.0]), axis=-1).reshape(-1, 3)
    >>> new = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 3.0]])  # before, on and behind the wall
    >>> contradicted_by(new, wall, tolerance=0.1)
    array([ True, False,  True])
    >>> contradicted_by(new, wall, origin=[0, 0, 0], tolerance=0.1)
    array([ True, False, False])
    """
    s, rest = check_points(points, "points", minimum=0, dimensions=(3,)), check_points(other, "other", dimensions=(3,))
    place = check_origin(origin, "origin", 3)
    check_lengths(tolerance=0.0 if tolerance is None else tolerance)
    if len(s) == 0:
        return np.zeros(0, dtype=bool)
    distance = np.asarray(cKDTree(rest).query(s)[0])
    if tolerance is None:
        tolerance = 3 * max(point_spacing(rest), float(np.median(distance)))
    if place is None:
        return distance > tolerance
    return np.asarray(looks_from(s, place, rest, tolerance).past > 0)


def _region(points: Floats, votes: Bools | None) -> Region:
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = tuple(map(float, (low + high) / 2)), tuple(map(float, high - low))
    return Region(len(points), middle, size, None if votes is None else float(votes.mean()))
