"""Many depth frames fused into one map: a truncated signed distance function (chapter 1).

After Curless & Levoy (1996): every frame says how far each voxel near a surface lies in front of it (+) or behind it
(-); the weighted mean over frames crosses zero on the surface. Weights and the space seen to be free are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from gmmcd_teach.lab.camera import axial_sigma, frame_pixels, frame_points, project
from gmmcd_teach.lab.pair import Bools, DepthFrame
from gmmcd_teach.lab.shapes import Floats, Ints, inverse, transform
from gmmcd_teach.progress import progress_bar

VOXEL = 0.008  # metres: below a pixel's footprint (1 cm) at 2 m
BLOCK = 4  # voxels: surfaces are looked for in blocks, and distances are cut off at one block
SAMPLES = 8  # measurements that make a block worth looking at
SMOOTH = 0.025  # relative spread of the four depths around a voxel above which an edge runs between them
STEEPEST = 1.2  # metres of distance per metre along its gradient: a true distance changes by 1 at most
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
    corners = lower + blocks * block_size
    weighted, weights = np.zeros((2, len(blocks), BLOCK**3))
    support, free = np.zeros(weights.shape, dtype=np.int16), np.zeros(len(every_block), dtype=np.int64)
    for frame in progress_bar(frames, desc="fusing", unit="frame", shown=progress):
        free += seen_through(frame, every_block, block_size)
        near = in_view(frame, corners + block_size / 2)
        to_camera = inverse(frame.pose)
        voxels = transform(to_camera, corners[near])[:, None] + within @ to_camera[:3, :3].T
        distance, weight = (
            part.reshape(-1, BLOCK**3) for part in signed_distance(frame, voxels.reshape(-1, 3), block_size)
        )
        weighted[near] += weight * np.minimum(distance, block_size)
        weights[near] += weight
        support[near] += weight > 0
    mean = np.where(support >= SUPPORT, weighted / np.where(weights > 0, weights, 1), np.nan)
    points, point_weights = zero_crossings(blocks, corners[:, None] + within, mean, weights, shape, voxel_size)
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
    (column, row), depth = frame_pixels(frame, centres)
    margin = 10
    height, width = frame.depth.shape
    return (
        (depth > 0)
        & (np.abs(column - width / 2) < width / 2 + margin)
        & (np.abs(row - height / 2) < height / 2 + margin)
    )


def signed_distance(frame: DepthFrame, points: Floats, cutoff: float) -> tuple[Floats, Floats]:
    """How far (N,) points (N, 3) of the camera frame lie before the surface that it sees there, and a weight (N,).

    The weight is 0, and the distance too, where no single surface was measured.
    """
    (column, row), depth = project(points, frame.intrinsics)
    height, width = frame.depth.shape
    inside = np.flatnonzero((depth > 0) & (column >= 0) & (row >= 0) & (column < width - 1) & (row < height - 1))
    column, row = column[inside], row[inside]
    left, top = column.astype(np.int64), row.astype(np.int64)  # rounds down: both are positive
    squares = surface_squares(frame)
    square = top * (width - 1) + left
    use = np.flatnonzero(squares[0][square] > 0)
    square, right, below = square[use], (column - left)[use], (row - top)[use]
    trust, facing, base, across, down, twist = (part[square] for part in squares)
    surface = 1 / (base + right * across + below * (down + right * twist))
    distance, weight = np.zeros((2, len(points)))
    before = surface - depth[inside[use]]
    distance[inside[use]] = facing * before
    weight[inside[use]] = np.where(before > -cutoff, trust, 0)
    return distance, weight


def surface_squares(frame: DepthFrame) -> tuple[Floats, ...]:
    """For each square of four pixels ((H - 1)(W - 1),): trust, cosine of its slant, and 1/z as four bilinear terms.

    1/z is linear across the image of a plane, so its slope tells how the surface faces the camera. Trust falls with
    the slant (as in Curless & Levoy) and with the noise at that depth; it is 0 next to edges, where
    two surfaces mix.
    """
    fx, fy, _, _ = frame.intrinsics
    inverse_depth = 1 / frame.depth
    a, b = inverse_depth[:-1, :-1], inverse_depth[:-1, 1:]
    c, d = inverse_depth[1:, :-1], inverse_depth[1:, 1:]
    slope = ((fx * (b - a)) ** 2 + (fy * (c - a)) ** 2) / a**2
    spread = np.maximum(np.maximum(a, b), np.maximum(c, d)) - np.minimum(np.minimum(a, b), np.minimum(c, d))
    facing = 1 / np.sqrt(1 + slope)
    trust = (facing / axial_sigma(1 / a, np.zeros(1))) ** 2
    edge = ~(spread < SMOOTH * a)  # or a pixel without return
    trust[binary_dilation(edge, np.ones((3, 3), dtype=bool))] = 0
    return tuple(part.ravel() for part in (trust, facing, a, b - a, c - a, a - b - c + d))


def seen_through(frame: DepthFrame, centres: Floats, block_size: float) -> Bools:
    """Which blocks (centres (B, 3)) the frame's rays pass, with a block to spare before they meet a surface."""
    (column, row), depth = frame_pixels(frame, centres)
    height, width = frame.depth.shape
    inside = np.flatnonzero(
        (depth > 0) & (column > -0.5) & (row > -0.5) & (column < width - 0.5) & (row < height - 0.5)
    )
    measured = frame.depth[np.rint(row[inside]).astype(np.int64), np.rint(column[inside]).astype(np.int64)]
    through = np.zeros(len(centres), dtype=bool)
    through[inside] = measured > depth[inside] + block_size
    return through


def zero_crossings(
    blocks: Ints, centres: Floats, mean: Floats, weights: Floats, shape: tuple[int, ...], voxel_size: float
) -> tuple[Floats, Floats]:
    """Points (N, 3) where the mean distance changes sign between neighbouring voxels, with the weight (N,) of the pair.

    Where it changes faster than distance can, frames contradict each other, as at outlines: left out.
    """
    grid = np.array(shape) * BLOCK + 1
    voxel = (blocks * BLOCK)[:, None] + np.indices((BLOCK,) * 3).reshape(3, -1).T  # (B, BLOCK^3, 3)
    flat = np.ravel_multi_index(tuple(voxel.reshape(-1, 3).T), tuple(grid))
    index = np.full(int(grid.prod()), -1, dtype=np.int32)
    index[flat] = np.arange(len(flat))
    value, weight, position = mean.ravel(), weights.ravel(), centres.reshape(-1, 3)
    strides = (grid[1] * grid[2], grid[2], 1)
    known = np.append(value, np.nan)  # index -1 is the voxel that no frame knows
    gradient = [central_difference(known[index[flat - s]], value, known[index[flat + s]]) for s in strides]
    points, point_weights = [], []
    for axis, stride in enumerate(strides):
        here = np.flatnonzero((index[flat + stride] >= 0) & np.isfinite(value))
        there = index[flat[here] + stride]
        a, b = value[here], value[there]
        crossing = np.flatnonzero(np.sign(a) != np.sign(b))
        a, b, here, there = a[crossing], b[crossing], here[crossing], there[crossing]
        across = [(slope[here] + slope[there]) / 2 for i, slope in enumerate(gradient) if i != axis]
        gentle = (a - b) ** 2 + across[0] ** 2 + across[1] ** 2 < (STEEPEST * voxel_size) ** 2
        point = position[here[gentle]].copy()
        point[:, axis] += voxel_size * (a / (a - b))[gentle]
        points.append(point)
        point_weights.append(np.minimum(weight[here], weight[there])[gentle])
    return np.concatenate(points), np.concatenate(point_weights)


def central_difference(before: Floats, here: Floats, after: Floats) -> Floats:
    """Half of `after - before`; where one of them is not known (NaN) the step to the other; where neither is, 0."""
    steps = np.stack([here - before, after - here])
    known = np.isfinite(steps)
    return np.where(known, steps, 0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
