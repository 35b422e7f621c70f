"""Exercises of chapter 9: the whole method, from components and voxels back to points and objects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gmmcd_teach.exercises.checking import Exercise, Mistake, register
from gmmcd_teach.lab.pair import Bools


def claimed_points(owners: Any, taken: Any) -> Bools:
    """(N,) bool: does each point belong to a component that was taken?"""
    return np.isin(owners, taken)


def to_all_points(kept: Bools, membership: Any, voxel_changed: Bools) -> Bools:
    """(N,) bool from one answer for each voxel; points that were filtered out have not changed."""
    changed = np.zeros(len(kept), dtype=bool)
    changed[kept] = voxel_changed[membership]
    return changed


def objects_found(claimed: Bools, objects: Any) -> Bools:
    """(objects,) bool: are more than half of each object's points claimed?"""
    return np.bincount(objects, weights=claimed)[1:] > np.bincount(objects)[1:] / 2


def _owners() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        yield np.random.default_rng(seed).integers(0, 6, 40), np.array([4, 1, 3])


def _voxels() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        kept = rng.random(30) < 0.7
        membership = rng.integers(0, 8, np.count_nonzero(kept))
        yield kept, membership, rng.permutation(np.arange(8) < 4)


def _objects() -> Iterator[tuple[Any, ...]]:
    """In the last case, object 1 has more than half of all claimed points, but less than half of all points."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        sizes = [60, 8, 12, 10, 9] if seed < 3 else [60, 40, 12, 10, 9]
        objects = rng.permutation(np.repeat([0, 1, 2, 3, 4], sizes))
        share = np.array([0.3 if seed < 3 else 0.1, 0.9, 0.25, 0.5, 0.7])[objects]
        claimed = rng.random(len(objects)) < share
        claimed[np.flatnonzero(objects == 3)] = np.arange(10) < 5  # exactly half: not found
        yield claimed, objects


register(
    Exercise(
        "ex-09-1",
        _owners,
        claimed_points,
        (
            Mistake(
                "the two arguments of np.isin are swapped: ask of each point's component whether it was taken",
                lambda owners, taken: np.isin(taken, owners),
            ),
            Mistake(
                "those are the indices of the points; return one bool for each point instead",
                lambda owners, taken: np.flatnonzero(np.isin(owners, taken)),
            ),
            Mistake(
                "that is turned around: True is for the components that were taken, they are the change",
                lambda owners, taken: ~np.isin(owners, taken),
            ),
            Mistake(
                "you look at the first component taken only; all of them are the change",
                lambda owners, taken: owners == taken[0],
            ),
            Mistake(
                "that is one answer for each component; look it up for each point with [owners]",
                lambda owners, taken: np.isin(np.arange(owners.max() + 1), taken),
            ),
        ),
    ),
    Exercise(
        "ex-09-2",
        _voxels,
        to_all_points,
        (
            Mistake(
                "those are the answers for the points that were kept; put them in their places among all N points",
                lambda kept, membership, changed: changed[membership],
            ),
            Mistake(
                "you let the points that were filtered out count as changed; nothing is known of them, so say False",
                lambda kept, membership, changed: _filled(kept, changed[membership], True),
            ),
            Mistake(
                "that is which points were kept; it says nothing of change yet: look each one's voxel up",
                lambda kept, membership, changed: kept.copy(),
            ),
            Mistake(
                "you wrote the answers into the first places; write into changed[kept], the places of the kept points",
                lambda kept, membership, changed: np.append(changed[membership], np.zeros((~kept).sum(), dtype=bool)),
            ),
            Mistake(
                "that is turned around: True is for points in voxels that have changed",
                lambda kept, membership, changed: _filled(kept, ~changed[membership], False),
            ),
        ),
    ),
    Exercise(
        "ex-09-3",
        _objects,
        objects_found,
        (
            Mistake(
                "you count group 0 too, but 0 means no object: leave the first entry out",
                lambda claimed, objects: np.bincount(objects, weights=claimed) > np.bincount(objects) / 2,
            ),
            Mistake(
                "one claimed point is not enough: an object is found if more than half of its points are claimed",
                lambda claimed, objects: np.bincount(objects, weights=claimed)[1:] > 0,
            ),
            Mistake(
                "exactly half is not more than half: use > and not >=",
                lambda claimed, objects: np.bincount(objects, weights=claimed)[1:] >= np.bincount(objects)[1:] / 2,
            ),
            Mistake(
                "you divide by the number of all claimed points; divide by the number of points of the object",
                lambda claimed, objects: np.bincount(objects, weights=claimed)[1:] > claimed.sum() / 2,
            ),
            Mistake(
                "those are shares; compare them with one half and return bools",
                lambda claimed, objects: np.bincount(objects, weights=claimed)[1:] / np.bincount(objects)[1:],
            ),
        ),
    ),
)


def _filled(kept: Bools, answers: Bools, otherwise: bool) -> Bools:
    changed = np.full(len(kept), otherwise)
    changed[kept] = answers
    return changed
