"""Exercises of chapter 18: your own scans."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]


def share_inside(points: Floats, others: Floats) -> float:
    """Share of the points (N, 3) within the box around the others (M, 3)."""
    inside = (points >= others.min(axis=0)) & (points <= others.max(axis=0))  # (N, 3)
    return float(inside.all(axis=1).mean())


def confidences(groups: Ints, contradicted: Bools) -> Floats:
    """(G,) share of the points of each group 0 to G - 1 that the other scan contradicts."""
    return np.bincount(groups, weights=contradicted) / np.bincount(groups)


def xyz_of_message(data: Bytes, point_step: int, offset: int) -> Floats:
    """(N, 3) little-endian float32 coordinates that stand side by side from byte `offset` of each point on."""
    rows = data.reshape(-1, point_step)[:, offset : offset + 12]  # (N, 12) bytes
    return np.ascontiguousarray(rows).view("<f4").astype(np.float64)


def _boxes() -> Iterator[tuple[Floats, Floats]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.uniform(0, 3, (60, 3)), rng.uniform([0.2, 1.0, 0.7], [1.9, 2.7, 2.4], (30, 3))


def _groups() -> Iterator[tuple[Ints, Bools]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        groups = rng.permutation(np.repeat(np.arange(4), [5, 9, 14, 20]))
        contradicted = rng.random(48) < np.array([0.9, 0.1, 0.5, 0.7])[groups]
        yield groups, contradicted


def _messages() -> Iterator[tuple[Bytes, int, int]]:
    for seed, (step, offset) in enumerate(((32, 4), (24, 8), (20, 4))):
        rng = np.random.default_rng(seed)
        data = rng.uniform(1, 2, (12, step // 4)).astype("<f4")  # other numbers stand around the coordinates
        data[:, offset // 4 : offset // 4 + 3] = rng.uniform(-3, 3, (12, 3))
        yield data.view(np.uint8).ravel(), step, offset


register(
    Exercise(
        "ex-18-1",
        _boxes,
        share_inside,
        (
            Mistake(
                "a point is inside only if all three coordinates are: all(axis=1) before the mean",
                lambda a, b: float(((a >= b.min(axis=0)) & (a <= b.max(axis=0))).mean()),
            ),
            Mistake(
                "one coordinate inside is not enough: a point above the box is not in it; take all(axis=1), not any",
                lambda a, b: float(((a >= b.min(axis=0)) & (a <= b.max(axis=0))).any(axis=1).mean()),
            ),
            Mistake(
                "the two clouds are swapped: ask of `points`, with the box around `others`",
                lambda a, b: share_inside(b, a),
            ),
            Mistake(
                "that is how many; divide by the number of points to get a share",
                lambda a, b: float(share_inside(a, b) * len(a)),
            ),
            Mistake(
                "you ask only for the upper corner of the box; a point must lie above the lower one, too",
                lambda a, b: float((a <= b.max(axis=0)).all(axis=1).mean()),
            ),
            Mistake(
                "the box is one number for all axes; take min and max along axis=0, so that each axis has its own",
                lambda a, b: float(((a >= b.min()) & (a <= b.max())).all(axis=1).mean()),
            ),
        ),
    ),
    Exercise(
        "ex-18-2",
        _groups,
        confidences,
        (
            Mistake(
                "those are counts; divide by the number of points in each group",
                lambda g, c: np.bincount(g, weights=c),
            ),
            Mistake(
                "you divided by the number of all points; a share of a group is out of that group's points",
                lambda g, c: np.bincount(g, weights=c) / len(g),
            ),
            Mistake(
                "you divided by the number of contradicted points; that says where the evidence lies, not how much of "
                "each group it covers",
                lambda g, c: np.bincount(g, weights=c) / c.sum(),
            ),
            Mistake(
                "that is the share that the other scan does not contradict: turn it round",
                lambda g, c: 1 - confidences(g, c),
            ),
            Mistake(
                "that is one number for all groups; group by group, np.bincount(groups, weights=...)",
                lambda g, c: float(c.mean()),
            ),
        ),
    ),
    Exercise(
        "ex-18-3",
        _messages,
        xyz_of_message,
        (
            Mistake(
                "you did not skip the bytes before x: the coordinates begin at `offset` within each point",
                lambda data, step, offset: xyz_of_message(data, step, 0),
            ),
            Mistake(
                "you took the bytes one after the other; between two points stand other fields, so cut the data into "
                "rows of point_step bytes first",
                lambda data, step, offset: data.view("<f4")[: len(data) // step * 3].reshape(-1, 3).astype(float),
            ),
            Mistake(
                "the offset counts from the start of each point, not of the whole message: first rows, then columns",
                lambda data, step, offset: (
                    data[offset:].view("<f4")[: len(data) // step * 3].reshape(-1, 3).astype(float)
                ),
            ),
            Mistake(
                "the bytes are in the wrong order: little-endian is '<f4', big-endian '>f4'",
                lambda data, step, offset: xyz_of_message(data, step, offset).astype("<f4").view(">f4").astype(float),
            ),
            Mistake(
                "those are the bytes themselves; let NumPy read four of them as one number: .view('<f4')",
                lambda data, step, offset: data.reshape(-1, step)[:, offset : offset + 12].astype(float),
            ),
            Mistake(
                "offset counts bytes, not numbers: a float32 has four of them",
                lambda data, step, offset: np.roll(data.view("<f4").reshape(len(data) // step, -1), -offset, axis=1)[
                    :, :3
                ].astype(float),
            ),
        ),
    ),
)
