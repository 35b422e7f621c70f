"""What every league table needs below it: distance to the nearest point, M3C2, and a grid of cells (chapter 17)."""

from __future__ import annotations

from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from gmmcd_teach.beyond.surface import nearest, point_spacing, surface_of
from gmmcd_teach.clouds import Floats, check_points
from gmmcd_teach.detection import Bools, Detection, Stopwatch
from gmmcd_teach.starts import is_above_zero

SIGMAS = 3.0  # a distance this many standard deviations long is no accident
MAX_SLICES = 10_000  # of the cylinder of M3C2 on each side of its middle


def detect_c2c(before: ArrayLike, after: ArrayLike, *, noise: float = 0.01, alignment_error: float = 0.01) -> Detection:
    """Cloud to cloud: a point has changed if the other cloud has no point near it (Girardeau-Montaut et al. 2005).

    Near is within three standard deviations of noise and misalignment together, plus the spacing of the points.

    Parameters
    ----------
    before, after : (N, D) metres.
    noise : metres, standard deviation of a measured point.
    alignment_error : metres, how far the clouds may be off each other.

    Raises
    ------
    CloudError
        A cloud cannot be used, or the clouds differ in dimension.
    ValueError
        An option is not a length.

    Examples
    --------
    >>> line = np.linspace(0, 1, 50)[:, None]
    >>> detect_c2c(line, np.concatenate([line, [[2.0]]])).appeared.nonzero()[0]
    array([50])
    """
    check_lengths(noise=noise, alignment_error=alignment_error)
    old = check_points(before, "before")
    new = check_points(after, "after", dimensions=old.shape[1:])
    watch = Stopwatch()
    reach = SIGMAS * np.hypot(noise, alignment_error) + max(point_spacing(old), point_spacing(new))
    changed = [nearest(KDTree(there), here)[0][:, 0] > reach for here, there in ((new, old), (old, new))]
    return finished(changed[0], changed[1], watch)


def detect_m3c2(
    before: ArrayLike,
    after: ArrayLike,
    *,
    leaf_size: float | None = None,
    cylinder_radius: float | None = None,
    max_depth: float = 0.2,
    alignment_error: float = 0.01,
) -> Detection:
    """M3C2: distances along the surface's normal, beside the smallest one that can be told (Lague et al. 2013).

    Core points are cells of the cloud. A cylinder along each normal collects the points of both clouds; a cell has
    changed if their mean positions differ by more than the level of detection, or if the other cloud has none there.

    Parameters
    ----------
    before, after : (N, 3) metres.
    leaf_size : metres, size of the cells; None takes twice the spacing of the points.
    cylinder_radius : metres; None takes 1.5 cells.
    max_depth : metres, half the length of the cylinder; at most 10,000 radii.
    alignment_error : metres, standard deviation of the registration.

    Raises
    ------
    CloudError
        A cloud cannot be used.
    ValueError
        An option is not a length.

    Examples
    --------
    >>> floor = np.stack(np.meshgrid(np.arange(0, 1, 0.02), np.arange(0, 1, 0.02), [0.0]), -1).reshape(-1, 3)
    >>> bool(detect_m3c2(floor, floor + [0, 0, 0.1]).appeared.all())
    True
    """
    check_lengths(alignment_error=alignment_error)
    check_sizes(leaf_size=leaf_size, cylinder_radius=cylinder_radius)
    if not is_above_zero(max_depth):
        raise ValueError(f"max_depth = {max_depth!r}; expected a finite length in metres above 0")
    old, new = check_points(before, "before", dimensions=(3,)), check_points(after, "after", dimensions=(3,))
    watch = Stopwatch()
    leaf = leaf_size or 2 * max(point_spacing(old), point_spacing(new)) or 1.0
    radius = cylinder_radius or 1.5 * leaf
    if max_depth > MAX_SLICES * radius:
        raise ValueError(
            f"cylinder_radius = {radius:g}; expected at least {max_depth / MAX_SLICES:g}: a larger leaf_size?"
        )
    changed = []
    for here, there in ((new, old), (old, new)):
        cells = surface_of(here, leaf)
        distance, detectable = m3c2_distances(
            cells.centroids, cells.normals, here, there, radius, max_depth, alignment_error
        )
        changed.append(~(np.abs(distance) <= detectable)[cells.membership])
    return finished(changed[0], changed[1], watch)


def m3c2_distances(
    cores: Floats, normals: Floats, here: Floats, there: Floats, radius: float, max_depth: float, alignment_error: float
) -> tuple[Floats, Floats]:
    """Distances (M,) from `here` to `there` along the normals, and levels of detection (M,), metres; NaN where
    a cylinder holds no points. LoD = 1.96 (sqrt(s1^2 / n1 + s2^2 / n2) + registration error), Eq. 1 of Lague et al.

    Examples
    --------
    >>> flat = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), [0.0]), -1).reshape(-1, 3)
    >>> up = np.array([[0, 0, 1.0]])
    >>> d, lod = m3c2_distances(np.array([[4.0, 4, 0]]), up, flat, flat + [0, 0, 2], 1.5, 3.0, 0.1)
    >>> float(d[0]), round(float(lod[0]), 3)
    (2.0, 0.196)
    """
    count, mean, variance = (
        np.stack(part)
        for part in zip(
            *(along_normals(cores, normals, cloud, radius, max_depth) for cloud in (here, there)), strict=True
        )
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt((variance / count).sum(axis=0))
    return mean[1] - mean[0], 1.96 * (error + alignment_error)


def along_normals(
    cores: Floats, normals: Floats, points: Floats, radius: float, max_depth: float
) -> tuple[Floats, Floats, Floats]:
    """Count (M,), mean (M,) and variance (M,) of the points' heights along each normal, within its cylinder.

    Spheres strung along the axis, a radius apart, find the points that can lie in the cylinder.

    Examples
    --------
    >>> heights = np.array([[0, 0, 0.1], [0, 0, 0.3], [0.9, 0, 0.2]])
    >>> n, mean, variance = along_normals(np.zeros((1, 3)), np.array([[0, 0, 1.0]]), heights, 0.5, 1.0)
    >>> float(n[0]), round(float(mean[0]), 3), round(float(variance[0]), 3)
    (2.0, 0.2, 0.02)
    """
    steps = np.linspace(-max_depth, max_depth, 2 * int(np.ceil(max_depth / radius)) + 1)
    tree, reach = KDTree(points), np.hypot(radius, steps[1] - steps[0])
    count, total, squares = np.zeros((3, len(cores)))
    half = (steps[1] - steps[0]) / 2
    for step in steps:  # each sphere answers for its own slice of the cylinder
        found = tree.query_ball_point(cores + step * normals, reach)
        core = np.repeat(np.arange(len(cores)), [len(f) for f in found])
        offset = points[np.concatenate(found).astype(np.intp)] - cores[core]
        height = (offset * normals[core]).sum(axis=1)
        across = (offset**2).sum(axis=1) - height**2
        slice_end = height < step + half if step < steps[-1] else height <= max_depth
        inside = (across <= radius**2) & (height >= max(step - half, -max_depth)) & slice_end
        for target, value in ((count, np.ones_like(height)), (total, height), (squares, height**2)):
            target += np.bincount(core[inside], value[inside], len(cores))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count
        variance = np.clip(squares - count * mean**2, 0, None) / (count - 1)
    return count, np.where(count > 0, mean, np.nan), np.where(count > 1, variance, 0.0)


def detect_occupancy(
    before: ArrayLike, after: ArrayLike, *, leaf_size: float | None = None, alignment_error: float = 0.01
) -> Detection:
    """Occupancy: a point has changed if the other cloud has none in its cell of a grid, nor in the cells next to it.

    Parameters
    ----------
    before, after : (N, D) metres.
    leaf_size : metres, edge of a cell; None takes three times the alignment error, or the spacing where it is larger.
    alignment_error : metres, how far the clouds may be off each other.

    Raises
    ------
    CloudError
        A cloud cannot be used, or the clouds differ in dimension.
    ValueError
        An option is not a length.

    Examples
    --------
    >>> line = np.linspace(0, 1, 50)[:, None]
    >>> detect_occupancy(line, np.concatenate([line, [[2.0]]])).appeared.nonzero()[0]
    array([50])
    """
    check_lengths(alignment_error=alignment_error)
    check_sizes(leaf_size=leaf_size)
    old = check_points(before, "before")
    new = check_points(after, "after", dimensions=old.shape[1:])
    watch = Stopwatch()
    leaf = leaf_size or max(SIGMAS * alignment_error, point_spacing(old), point_spacing(new)) or 1.0
    cells = [np.floor(cloud / leaf) for cloud in (new, old)]
    changed = [
        np.asarray(KDTree(np.unique(there, axis=0)).query(here, p=np.inf)[0]) > 1
        for here, there in (cells, cells[::-1])
    ]  # Chebyshev distance 1: the cell itself and all that touch it
    return finished(changed[0], changed[1], watch)


def finished(appeared: Bools, disappeared: Bools, watch: Stopwatch, **found: Any) -> Detection:
    """The detection, with the time since the watch started filed under "compare"."""
    watch("compare")
    return Detection(appeared, disappeared, seconds=watch.seconds, **found)


def check_lengths(**lengths: float) -> None:
    """Raise a ValueError that names the first option that is no length in metres.

    Examples
    --------
    >>> check_lengths(noise=0.01)
    """
    for name, value in lengths.items():
        if isinstance(value, bool) or not (isinstance(value, Real) and 0 <= value < np.inf):
            raise ValueError(f"{name} = {value!r}; expected a finite length in metres, 0 or more")


def check_sizes(**sizes: float | None) -> None:
    """Raise a ValueError that names the first option that is neither a length above 0 in metres nor None.

    Examples
    --------
    >>> check_sizes(leaf_size=0.02, patch_size=None)
    """
    for name, value in sizes.items():
        if value is not None and not is_above_zero(value):
            raise ValueError(f"{name} = {value!r}; expected a finite length in metres above 0, or None")
