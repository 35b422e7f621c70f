"""Many depth frames fused into one map: a truncated signed distance function (chapter 1).

After Curless & Levoy (1996): every frame says how far each voxel near a surface lies in front of it (+) or behind it
(-); the weighted mean over frames crosses zero on the surface. Weights and the space seen to be free are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation
from tqdm.auto import tqdm

from gmmcd_teach.lab.camera import axial_sigma, frame_pixels, frame_points
from gmmcd_teach.lab.pair import Bools, DepthFrame
from gmmcd_teach.lab.shapes import Floats, Ints

VOXEL = 0.008  # metres: below a pixel's footprint (1 cm) at 2 m
BLOCK = 4  # voxels: surfaces are looked for in blocks, and distances are cut off at one block
SAMPLES = 8  # measurements that make a block worth looking at
SMOOTH = 0.05  # relative spread of the four depths around a voxel above which an edge runs between them
SUPPORT = 3  # frames that must have seen both ends of a crossing


@dataclass(frozen=True)
class FusedMap:
    """A map: points (N, 3) in metres, the weight (N,) behind each (1/m^2), and the free space that the survey saw.

    `free` (X, Y, Z) counts, for blocks of `block_size` metres from the corner `lower` (3,) on, the frames that looked
    right through.
    """

    points: Floats
    weights: Floats
    free: Ints
    lower: Floats
    block_size: float


def fuse(
    frames: Sequence[DepthFrame],
    boundary: tuple[tuple[float, float, float], tuple[float, float, float]],
    *,
    voxel_size: float = VOXEL,
    progress: bool = False,
) -> FusedMap:
    """Fuse depth frames, by their estimated poses, into the surfaces inside a box (lower corner, upper corner)."""
    lower, upper = (np.asarray(corner, dtype=np.float64) for corner in boundary)
    block_size = BLOCK * voxel_size
    shape = tuple(np.ceil((upper - lower) / block_size).astype(int))
    blocks = surface_blocks(frames, lower, block_size, shape)  # (B, 3)
    every_block = lower + (np.indices(shape).reshape(3, -1).T + 0.5) * block_size
    within = (np.indices((BLOCK,) * 3).reshape(3, -1).T + 0.5) * voxel_size  # (BLOCK^3, 3)
    centres = (lower + blocks * block_size)[:, None] + within  # (B, BLOCK^3, 3)
    weighted, weights = np.zeros(centres.shape[:2]), np.zeros(centres.shape[:2])
    support, free = np.zeros(centres.shape[:2], dtype=np.int16), np.zeros(len(every_block), dtype=np.int64)
    for frame in tqdm(frames, desc="fusing", unit="frame", disable=not progress):
        free += seen_through(frame, every_block, block_size)
        near = in_view(frame, centres.mean(axis=1))
        distance, depth = signed_distance(frame, centres[near].reshape(-1, 3))
        known = distance > -block_size  # False for NaN
        weight = np.where(known, 1 / axial_sigma(np.where(known, depth, 1), np.zeros(1)) ** 2, 0).reshape(-1, BLOCK**3)
        weighted[near] += weight * np.where(known, np.minimum(distance, block_size), 0).reshape(weight.shape)
        weights[near] += weight
        support[near] += known.reshape(weight.shape)
    with np.errstate(invalid="ignore"):
        mean = np.where(support >= SUPPORT, weighted / weights, np.nan)
    points, point_weights = zero_crossings(blocks, centres, mean, weights, shape, voxel_size)
    inside = ((points >= lower) & (points <= upper)).all(axis=1)
    return FusedMap(points[inside], point_weights[inside], free.reshape(shape), lower, block_size)


def surface_blocks(frames: Sequence[DepthFrame], lower: Floats, block_size: float, shape: tuple[int, ...]) -> Ints:
    """Blocks (B, 3) that hold measurements, and all blocks next to them."""
    count = np.zeros(shape, dtype=np.int64)
    for frame in frames:
        cell = np.floor((frame_points(frame) - lower) / block_size).astype(np.int64)
        cell = cell[((cell >= 0) & (cell < shape)).all(axis=1)]
        count += np.bincount(np.ravel_multi_index(tuple(cell.T), shape), minlength=count.size).reshape(shape)
    return np.argwhere(binary_dilation(count >= SAMPLES, np.ones((3, 3, 3), dtype=bool)))


def in_view(frame: DepthFrame, centres: Floats) -> Bools:
    """Which block centres (B, 3) may have voxels inside the frame's image."""
    pixel, depth = frame_pixels(frame, centres)
    margin = 10
    height, width = frame.depth.shape
    return (depth > 0) & ((pixel > -margin) & (pixel < [width + margin, height + margin])).all(axis=1)


def signed_distance(frame: DepthFrame, points: Floats) -> tuple[Floats, Floats]:
    """How far (N,) along the optical axis points (N, 3) lie before the surface seen there, and its depth (N,).

    The depth between four pixels is interpolated in 1/z, which is linear across the image of a plane. NaN where one of
    the four is missing or an edge runs between them.
    """
    pixel, depth = frame_pixels(frame, points)
    height, width = frame.depth.shape
    inside = np.flatnonzero((depth > 0) & (pixel >= 0).all(axis=1) & (pixel < [width - 1, height - 1]).all(axis=1))
    column, row = np.floor(pixel[inside]).astype(np.int64).T
    right, down = (pixel[inside] - np.stack([column, row], axis=1)).T
    inverse_depth = (1 / frame.depth).ravel()
    first = row * width + column
    corners = inverse_depth[first[:, None] + [0, 1, width, width + 1]]  # (n, 4)
    share = np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], axis=1)
    mean = (corners * share).sum(axis=1)
    mean[~(np.ptp(corners, axis=1) < SMOOTH * mean)] = np.nan
    surface = np.full(len(points), np.nan)
    surface[inside] = 1 / mean
    return surface - depth, surface


def seen_through(frame: DepthFrame, centres: Floats, block_size: float) -> Bools:
    """Which blocks (centres (B, 3)) the frame's rays pass, with a block to spare before they meet a surface."""
    pixel, depth = frame_pixels(frame, centres)
    height, width = frame.depth.shape
    column, row = np.where(np.isfinite(pixel), np.clip(np.rint(pixel), -1, 10**6), -1).astype(np.int64).T
    inside = np.flatnonzero((depth > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height))
    through = np.zeros(len(centres), dtype=bool)
    through[inside] = frame.depth[row[inside], column[inside]] > depth[inside] + block_size
    return through


def zero_crossings(
    blocks: Ints, centres: Floats, mean: Floats, weights: Floats, shape: tuple[int, ...], voxel_size: float
) -> tuple[Floats, Floats]:
    """Points (N, 3) where the mean distance changes sign between neighbouring voxels, with the weight (N,) of the pair.

    A step larger than twice the voxel is an outline, not a surface, and is left out.
    """
    grid = np.array(shape) * BLOCK + 1
    voxel = (blocks * BLOCK)[:, None] + np.indices((BLOCK,) * 3).reshape(3, -1).T  # (B, BLOCK^3, 3)
    flat = np.ravel_multi_index(tuple(voxel.reshape(-1, 3).T), tuple(grid))
    index = np.full(int(grid.prod()), -1, dtype=np.int32)
    index[flat] = np.arange(len(flat))
    value, weight, position = mean.ravel(), weights.ravel(), centres.reshape(-1, 3)
    points, point_weights = [], []
    for axis, stride in enumerate((grid[1] * grid[2], grid[2], 1)):
        here = np.flatnonzero((index[flat + stride] >= 0) & np.isfinite(value))
        there = index[flat[here] + stride]
        a, b = value[here], value[there]
        crossing = (np.sign(a) != np.sign(b)) & (np.abs(a - b) < 2 * voxel_size)
        a, b, here, there = a[crossing], b[crossing], here[crossing], there[crossing]
        point = position[here].copy()
        point[:, axis] += voxel_size * a / (a - b)
        points.append(point)
        point_weights.append(np.minimum(weight[here], weight[there]))
    return np.concatenate(points), np.concatenate(point_weights)
