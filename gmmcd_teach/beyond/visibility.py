"""Seen through, or hidden? What another scan says about the place of each point (chapter 16)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import KDTree

from gmmcd_teach.beyond.surface import distinct, nearest
from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.lab.camera import frame_pixels
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.mixture import floats

Ints = NDArray[np.int64]


class Looks(NamedTuple):
    """For each point: how many frames looked past it (N,), how many met a surface there (N,), and, where one met
    something nearer, a point (N, 3) of that; NaN elsewhere."""

    past: Ints
    met: Ints
    hider: Floats


def looks(
    points: Floats, scan: Floats, origin: ArrayLike | None, frames: Sequence[DepthFrame] | None, margin: float
) -> Looks:
    """What a scan says about the places of the points (N, 3): by its depth frames, else by where its sensor stood.

    Where neither is known, everything counts as looked past: then a missing surface is all there is to go by.

    Examples
    --------
    >>> looks(np.zeros((2, 3)), np.ones((9, 3)), None, None, 0.1).past
    array([1, 1])
    """
    if frames is not None:
        return looks_of_frames(points, frames, margin)
    if origin is not None:
        return looks_from(points, np.asarray(origin, dtype=np.float64), scan, margin)
    return Looks(
        np.ones(len(points), dtype=np.int64), np.zeros(len(points), dtype=np.int64), np.full((len(points), 3), np.nan)
    )


def looks_of_frames(points: Floats, frames: Sequence[DepthFrame], margin: float) -> Looks:
    """Project the points (N, 3) into each depth frame, and count.

    A frame has looked past a point if its pixel and the eight around it all measured more than `margin` (m) behind
    the point: so neither the outline of a nearer thing nor a pixel without return counts. It has met it if its pixel
    measured a depth within `margin` of the point's.

    Examples
    --------
    >>> frame = DepthFrame(np.full((5, 5), 2.0), np.eye(4), (2.0, 2.0, 2.0, 2.0))
    >>> past, met, hider = looks_of_frames(np.array([[0, 0, 1.0], [0, 0, 2.0], [0, 0, 3.0], [9, 0, 1.0]]), [frame], 0.1)
    >>> past.tolist(), met.tolist(), hider[2].tolist()
    ([1, 0, 0, 0], [0, 1, 0, 0], [0.0, 0.0, 2.0])
    """
    past, met = np.zeros((2, len(points)), dtype=np.int64)
    hider = np.full((len(points), 3), np.nan)
    for frame in frames:
        (column, row), depth = frame_pixels(frame, points)
        height, width = frame.depth.shape
        with np.errstate(invalid="ignore"):
            u, v = np.rint(column), np.rint(row)
        inside = np.flatnonzero((depth > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height))
        u, v = u[inside].astype(np.int64), v[inside].astype(np.int64)
        closest = minimum_filter(np.where(np.isfinite(frame.depth), frame.depth, -np.inf), 3, mode="nearest")
        past[inside] += closest[v, u] > depth[inside] + margin
        measured = frame.depth[v, u]
        met[inside] += np.abs(measured - depth[inside]) <= margin
        nearer = measured < depth[inside] - margin
        behind, eye = inside[nearer], frame.pose[:3, 3]
        hider[behind] = eye + (points[behind] - eye) * (measured[nearer] / depth[behind])[:, None]
    return Looks(past, met, hider)


def looks_from(points: Floats, origin: Floats, scan: Floats, margin: float, n_rays: int = 5) -> Looks:
    """The same for a scan of which only the points (M, 3) and the sensor's position (3,) are known.

    Each scanned point is a ray from the sensor. The `n_rays` rays next to a point's direction tell what was met
    there; where none passes within three times the usual angle between rays, the scan says nothing. Points that
    repeat another are one ray.

    Examples
    --------
    >>> wall = np.stack(np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50), [2.0]), -1).reshape(-1, 3)
    >>> asked = np.array([[0, 0, 1.0], [0, 0, 2.0], [0, 0, 3.0], [9, 0, 1.0]])
    >>> past, met, hider = looks_from(asked, np.zeros(3), wall, 0.1)
    >>> past.tolist(), met.tolist(), hider[2].round(2).tolist()
    ([1, 0, 0, 0], [0, 1, 0, 0], [0.0, 0.0, 2.0])
    """
    rays, measured = directions(scan, origin)
    tree = KDTree(rays)
    apart = nearest(tree, rays[:: max(1, len(rays) // 2000)], min(5, len(rays)))[0]
    if (apart[:, 1:2] == 0).any() and len(once := distinct(scan)) < len(scan):
        return looks_from(points, origin, once, margin, n_rays)
    step = float(np.median(apart[:, -1]))
    wanted, distance = directions(points, origin)
    _, near = nearest(tree, wanted, min(n_rays, len(rays)), 3 * step + 1e-12)
    reach = np.append(measured, -np.inf)[near]  # (N, n_rays), -inf where no ray passes
    past = reach.min(axis=1) > distance + margin
    met = np.abs(reach[:, 0] - distance) <= margin
    nearer = np.isfinite(reach[:, 0]) & (reach[:, 0] < distance - margin)
    hider = origin + wanted * np.where(nearer, reach[:, 0], np.nan)[:, None]
    return Looks(past.astype(np.int64), met.astype(np.int64), hider)


def directions(points: Floats, origin: Floats) -> tuple[Floats, Floats]:
    """Unit vectors (N, 3) from the sensor to the points, and the distances (N,) in metres."""
    ray = points - origin
    distance = np.linalg.norm(ray, axis=1)
    return ray / np.maximum(distance, 1e-12)[:, None], distance


def check_origin(origin: ArrayLike | None, name: str, n_dimensions: int) -> Floats | None:
    """(D,) position of a sensor in metres, or None; a CloudError where it is anything else.

    Examples
    --------
    >>> check_origin([0, 0, 1], "before_origin", 3)
    array([0., 0., 1.])
    """
    if origin is None:
        return None
    position = floats(origin, name)
    if position.shape != (n_dimensions,):
        raise CloudError(f"{name}: shape {position.shape}; expected ({n_dimensions},) finite metres")
    if not np.isfinite(position).all():
        raise CloudError(f"{name}: {position.tolist()} holds NaN or infinity; expected ({n_dimensions},) finite metres")
    return position


def check_frames(frames: Sequence[DepthFrame] | None, name: str) -> tuple[DepthFrame, ...] | None:
    """The depth frames of a scan, or None where there are none; a CloudError where they are anything else.

    Examples
    --------
    >>> check_frames([], "before_frames") is None
    True
    """
    if frames is None:
        return None
    told = tuple(frames) if isinstance(frames, Iterable) else (frames,)
    if strange := [frame for frame in told if not isinstance(frame, DepthFrame)]:
        raise CloudError(f"{name}: holds {type(strange[0]).__name__}; expected a sequence of DepthFrame")
    return told or None


ANSWERS = ("unchanged", "changed", "unknown")


def judge(
    points: ArrayLike,
    scan: ArrayLike,
    *,
    origin: ArrayLike | None = None,
    frames: Sequence[DepthFrame] | None = None,
    margin: float = 0.02,
) -> NDArray[np.int64]:
    """Answer for each point (N,), an index into `ANSWERS`, from what another scan (M, 3) saw at its place.

    Unchanged: the other scan has a point within `margin`. Changed: it has none, and looked past. Unknown: it has none,
    but something stood in the way, or it did not look there. Points of the earlier scan that have changed are gone,
    points of the later scan are new.

    Raises
    ------
    CloudError
        A cloud, an origin or a frame cannot be used.

    Examples
    --------
    >>> wall = np.stack(np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50), [2.0]), -1).reshape(-1, 3)
    >>> asked = [[0, 0, 1.0], [0, 0, 2.0], [0, 0, 3.0], [9, 0, 1.0]]
    >>> [ANSWERS[k] for k in judge(asked, wall, origin=[0, 0, 0], margin=0.05)]
    ['changed', 'unchanged', 'unknown', 'unknown']
    """
    s, other = check_points(points, dimensions=(3,)), check_points(scan, "scan", dimensions=(3,))
    origin, frames = check_origin(origin, "origin", 3), check_frames(frames, "frames")
    near = nearest(KDTree(other), s)[0][:, 0] <= margin
    return np.where(near, 0, np.where(looks(s, other, origin, frames, margin).past > 0, 1, 2))
