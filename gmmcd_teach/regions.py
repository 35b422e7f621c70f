"""From changed points to things: the connected groups of points that appeared or disappeared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gmmcd_teach.clouds import Floats, check_points


@dataclass(frozen=True)
class Region:
    """One connected group of changed points.

    Attributes
    ----------
    n_points : how many points.
    center : (x, y, z) metres, middle of the box around them.
    size : (x, y, z) metres, edges of that box.
    """

    n_points: int
    center: tuple[float, ...]
    size: tuple[float, ...]


def find_regions(points: ArrayLike, reach: float | None = None, smallest: int = 10) -> list[Region]:
    """Groups of points that hang together, the largest first.

    Parameters
    ----------
    points : (N, D) changed points, metres; N may be 0.
    reach : metres: points hang together when they lie in the same cube of this edge, or in cubes that touch; None takes
        three times their median spacing.
    smallest : groups of fewer points are left out.

    Raises
    ------
    CloudError
        The points are not (N, D) finite numbers.
    ValueError
        `reach` is not above 0.

    Examples
    --------
    >>> grid = np.stack(np.meshgrid(*[np.arange(5) / 100] * 3), axis=-1).reshape(-1, 3)
    >>> [region.n_points for region in find_regions(np.concatenate([grid, grid[:50] + 1]))]
    [125, 50]
    """
    s = check_points(points, "changed points", minimum=0)
    if reach is not None and not reach > 0:
        raise ValueError(f"reach = {reach}; expected metres above 0, or None")
    if len(s) < 2:
        return [_region(s)] if len(s) >= smallest else []
    if reach is None:
        spacing = np.asarray(cKDTree(s).query(s, k=2)[0])[:, 1]
        reach = 3 * float(np.median(spacing)) or 0.01
    cells, member = np.unique(np.floor(s / reach), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=bool), pairs.T), shape=(len(cells), len(cells)))
    group = connected_components(links, directed=False)[1][member.ravel()]
    found = [_region(s[group == number]) for number in range(group.max() + 1)]
    return sorted((r for r in found if r.n_points >= smallest), key=lambda r: -r.n_points)


def _region(points: Floats) -> Region:
    low, high = points.min(axis=0), points.max(axis=0)
    return Region(len(points), tuple(map(float, (low + high) / 2)), tuple(map(float, high - low)))
