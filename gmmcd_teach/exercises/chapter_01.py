"""Exercises of chapter 1: point clouds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Intrinsics = tuple[float, float, float, float]


def extent(points: Floats) -> Floats:
    """(D,) size of the cloud along each axis, metres."""
    return points.max(axis=0) - points.min(axis=0)


def depth_to_points(depth: Floats, intrinsics: Intrinsics) -> Floats:
    """(N, 3) points in the camera frame of the pixels of a depth image (H, W) that have a return, row by row."""
    fx, fy, cx, cy = intrinsics
    row, column = np.nonzero(np.isfinite(depth))  # (N,), (N,)
    z = depth[row, column]
    return np.column_stack([(column - cx) / fx * z, (row - cy) / fy * z, z])


def to_camera(points: Floats, pose: Floats) -> Floats:
    """(N, 3) world points in the frame of a camera whose pose (4, 4) goes from camera to world."""
    return (points - pose[:3, 3]) @ pose[:3, :3]


def _images() -> Iterator[tuple[Floats, Intrinsics]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(0.5, 3, (5, 7))
        depth[rng.random(depth.shape) < 0.2] = np.nan
        yield depth, (190.0, 180.0, 3.2, 1.7)


def _poses() -> Iterator[tuple[Floats, Floats]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        pose = np.eye(4)
        pose[:3, :3] = turn * np.linalg.det(turn)  # a rotation, no mirror image
        pose[:3, 3] = rng.normal(size=3)
        yield rng.normal(size=(6, 3)), pose


def _rays(depth: Floats, intrinsics: Intrinsics) -> Floats:
    return depth_to_points(np.where(np.isfinite(depth), 1.0, np.nan), intrinsics)  # (N, 3), z = 1


def _swapped(depth: Floats, intrinsics: Intrinsics) -> Floats:
    fx, fy, cx, cy = intrinsics
    row, column = np.nonzero(np.isfinite(depth))
    z = depth[row, column]
    return np.column_stack([(row - cx) / fx * z, (column - cy) / fy * z, z])


def _every_pixel(depth: Floats, intrinsics: Intrinsics) -> Floats:
    fx, fy, cx, cy = intrinsics
    row, column = np.indices(depth.shape)
    return np.stack([(column - cx) / fx * depth, (row - cy) / fy * depth, depth], axis=-1).reshape(-1, 3)


def _as_range(depth: Floats, intrinsics: Intrinsics) -> Floats:
    rays = _rays(depth, intrinsics)
    return depth[np.isfinite(depth)][:, None] * rays / np.linalg.norm(rays, axis=1, keepdims=True)


register(
    Exercise(
        "ex-01-1",
        lambda: ((np.random.default_rng(seed).normal(size=(9, 3)),) for seed in range(3)),
        extent,
        (
            Mistake("you went along the wrong axis: rows are points, so take axis=0", lambda s: np.ptp(s, axis=1)),
            Mistake(
                "that is one number for the whole cloud; say axis=0 to get one for each column", lambda s: np.ptp(s)
            ),
            Mistake("that is the largest coordinate; take the smallest one off it", lambda s: s.max(axis=0)),
            Mistake("the sign is turned around: largest minus smallest", lambda s: s.min(axis=0) - s.max(axis=0)),
        ),
    ),
    Exercise(
        "ex-01-2",
        _images,
        depth_to_points,
        (
            Mistake("rows and columns are swapped: x goes with the column, y with the row of a pixel", _swapped),
            Mistake(
                "you forgot the centre of the image: take cx off the column and cy off the row, or the "
                "camera looks along the wrong ray",
                lambda depth, k: depth_to_points(depth, (k[0], k[1], 0.0, 0.0)),
            ),
            Mistake(
                "these are directions, all with z = 1; stretch each one by the depth of its pixel",
                _rays,
            ),
            Mistake(
                "you took depth for the length of the ray. Depth is measured along the optical axis: it is z itself",
                _as_range,
            ),
            Mistake(
                "x and y are not stretched by the depth: the farther a pixel looks, the wider it is",
                lambda depth, k: np.column_stack([_rays(depth, k)[:, :2], depth[np.isfinite(depth)]]),
            ),
            Mistake("pixels without a return are still in it; keep those where the depth is finite", _every_pixel),
        ),
    ),
    Exercise(
        "ex-01-3",
        _poses,
        to_camera,
        (
            Mistake(
                "that is the way from the camera to the world; here the pose has to be undone",
                lambda s, pose: s @ pose[:3, :3].T + pose[:3, 3],
            ),
            Mistake(
                "the rotation goes the wrong way: its inverse is its transpose, and for points as rows that is "
                "(points - t) @ R",
                lambda s, pose: (s - pose[:3, 3]) @ pose[:3, :3].T,
            ),
            Mistake(
                "the order is wrong: the pose turns first and moves second, so undo the move first",
                lambda s, pose: s @ pose[:3, :3] - pose[:3, 3],
            ),
            Mistake(
                "you forgot where the camera stands: take its position pose[:3, 3] off first",
                lambda s, pose: s @ pose[:3, :3],
            ),
            Mistake(
                "you forgot that the camera is turned: multiply by the rotation pose[:3, :3]",
                lambda s, pose: s - pose[:3, 3],
            ),
        ),
    ),
)
