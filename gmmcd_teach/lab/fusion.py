"""Many depth frames fused into one map: a truncated signed distance function (chapter 1).

After Curless & Levoy (1996): every frame says how far each voxel near a surface lies in front of it (+) or behind it
(-); the weighted mean over frames crosses zero on the surface. Weights and the space seen to be free are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

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
AT_ONCE = 256  # blocks whose voxels fit the processor's cache
NOTHING = np.array([[0], [0], [1], [0], [0], [0]])  # a square without trust: 1/z = 1, so that no division fails


@dataclass(frozen=True, eq=False)
class FusedMap:
    """A map: points (N, 3) in metres, the weight (N,) behind each (1/m^2), and the frames that it was made of.

    Its blocks have edges of `block_size` metres, from the corner `lower` (3,) on; there are `shape` of them.
    """

    points: Floats
    weights: Floats
    frames: Sequence[DepthFrame]
    lower: Floats
    block_size: float
    shape: tuple[int, int, int]

    @cached_property
    def free(self) -> Ints:
        """Free space (X, Y, Z) that the survey saw: how many frames looked right through each block."""
        blocks = self.lower + (np.indices(self.shape).reshape(3, -1).T + 0.5) * self.block_size
        count = np.zeros(len(blocks), dtype=np.int64)
        for frame in self.frames:
            count += seen_through(frame, blocks, self.block_size)
        return count.reshape(self.shape)


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
    nx, ny, nz = np.ceil((upper - lower) / block_size).astype(int).tolist()
    blocks = surface_blocks(frames, lower, block_size, (nx, ny, nz))  # (B, 3)
    corners = lower + blocks * block_size
    within = (np.indices((BLOCK,) * 3).reshape(3, -1).T + 0.5) * voxel_size  # (BLOCK^3, 3)
    weighted, weights = np.zeros((2, len(blocks), BLOCK**3))
    support = np.zeros(weights.shape, dtype=np.int16)
    for frame in progress_bar(frames, desc="fusing", unit="frame", shown=progress):
        squares, to_camera = surface_squares(frame), inverse(frame.pose)
        near = np.flatnonzero(in_view(frame, corners + block_size / 2))
        for some in np.split(near, range(AT_ONCE, len(near), AT_ONCE)):
            corner, offset = transform(to_camera, corners[some]), within @ to_camera[:3, :3].T
            voxels = (corner.T[:, :, None] + offset.T[:, None]).reshape(3, -1)
            distance, weight = signed_distance(frame, voxels.T, block_size, squares)
            weight = weight.reshape(-1, BLOCK**3)
            weighted[some] += weight * np.minimum(distance, block_size).reshape(weight.shape)
            weights[some] += weight
            support[some] += weight > 0
    mean = np.where(support >= SUPPORT, weighted / np.where(weights > 0, weights, 1), np.nan)
    points, point_weights = zero_crossings(blocks, corners[:, None] + within, mean, weights, (nx, ny, nz), voxel_size)
    inside = ((points >= lower) & (points <= upper)).all(axis=1)
    return FusedMap(points[inside], point_weights[inside], frames, lower, block_size, (nx, ny, nz))


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


def signed_distance(
    frame: DepthFrame, points: Floats, cutoff: float, squares: Floats | None = None
) -> tuple[Floats, Floats]:
    """How far (N,) points (N, 3) of the camera frame lie before the surface that it sees there, and a weight (N,).

    The weight is 0 where no single surface was measured, the distance too. `squares`: `surface_squares(frame)`.
    """
    (column, row), depth = project(points, frame.intrinsics)
    height, width = frame.depth.shape
    inside = (depth > 0) & (column >= 0) & (row >= 0) & (column < width - 1) & (row < height - 1)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    left, top = column.astype(np.int64), row.astype(np.int64)  # rounds down: both are positive
    square = np.where(inside, top * (width - 1) + left, -1)  # the last square is of nothing
    known = surface_squares(frame) if squares is None else squares
    trust, facing, base, across, down, twist = known.take(square, axis=1)
    right, below = column - left, row - top
    before = 1 / (base + right * across + below * (down + right * twist)) - depth
    return facing * before, np.where(before > -cutoff, trust, 0)


def surface_squares(frame: DepthFrame) -> Floats:
    """For each square of four pixels (6, (H - 1)(W - 1) + 1): trust, cosine of its slant, 1/z as four bilinear terms.

    1/z is linear across the image of a plane, so its slope tells how the surface faces the camera. Trust falls with
    the slant (as in Curless & Levoy) and with the noise at that depth; it is 0 next to edges, where
    two surfaces mix, and for one square more than there are: what lies outside of the image.
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
    squares = np.array([trust, facing, a, b - a, c - a, a - b - c + d]).reshape(6, -1)
    return np.column_stack([np.where(squares[0] > 0, squares, NOTHING), NOTHING])


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
    strides = (grid[1] * grid[2], grid[2], 1)
    flat = np.add.outer(blocks @ strides * BLOCK, np.indices((BLOCK,) * 3).reshape(3, -1).T @ strides).ravel()
    index = np.full(int(grid.prod()), -1, dtype=np.int32)
    index[flat] = np.arange(len(flat))
    value, weight, position = mean.ravel(), weights.ravel(), centres.reshape(-1, 3)
    known = np.append(value, np.nan)  # index -1 is the voxel that no frame knows
    measured = np.flatnonzero(np.isfinite(value))
    points, point_weights = [], []
    for axis, stride in enumerate(strides):
        there = index[flat[measured] + stride]
        crossing = (there >= 0) & (np.sign(value[measured]) != np.sign(known[there]))
        here, there = measured[crossing], there[crossing]
        a, b = value[here], value[there]
        across = [
            sum(
                central_difference(known[index[flat[i] - s]], value[i], known[index[flat[i] + s]])
                for i in (here, there)
            )
            / 2
            for s in strides
            if s != stride
        ]
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
