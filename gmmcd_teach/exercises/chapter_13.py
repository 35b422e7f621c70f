"""Exercises of chapter 13: fast, in NumPy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def intensity(n_components: int, n_features: int, n_points: int) -> float:
    """Operations for each byte of a product of (K, F) and (F, N) float64 arrays, each array moved once."""
    k, f, n = n_components, n_features, n_points
    return 2 * k * f * n / (8 * (k * f + f * n + k * n))


def refresh(log_joint: Floats, reference: Floats) -> Floats:
    """(N,) log-densities from (K, N) log_joint, with the log-densities of the iteration before as reference."""
    return reference + np.log(np.exp(log_joint - reference).sum(axis=0))


def merge(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean (D,) and covariance (D, D) of all points from counts, means and covariances of cells."""
    share = counts / counts.sum()
    mean = share @ means
    second = covariances + means[:, :, None] * means[:, None, :]
    return mean, np.tensordot(share, second, axes=1) - np.outer(mean, mean)


def _sizes() -> Iterator[tuple[Any, ...]]:
    yield 25, 10, 38_528
    yield 50, 10, 1_600
    yield 3, 6, 7


def _densities() -> Iterator[tuple[Any, ...]]:
    for seed, level in enumerate((0.0, 3000.0, -3000.0)):
        rng = np.random.default_rng(seed)
        log_joint = rng.normal(0, 5, (4, 9)) + level + 400 * rng.normal(size=9)
        top = log_joint.max(axis=0)
        yield log_joint, top + rng.normal(0, 2, 9)


def _cells() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        m, d = 6, 3 - seed % 2
        a = rng.normal(size=(m, d, d))
        yield rng.integers(1, 40, m).astype(float), rng.normal(size=(m, d)), 0.1 * a @ a.swapaxes(1, 2)


def _one_operation(k: int, f: int, n: int) -> float:
    return intensity(k, f, n) / 2


def _without_result(k: int, f: int, n: int) -> float:
    return 2 * k * f * n / (8 * (k * f + f * n))


def _numbers(k: int, f: int, n: int) -> float:
    return 8 * intensity(k, f, n)


def _single(k: int, f: int, n: int) -> float:
    return 2 * intensity(k, f, n)


def _upside_down(k: int, f: int, n: int) -> float:
    return 1 / intensity(k, f, n)


def _change_only(log_joint: Floats, reference: Floats) -> Floats:
    return refresh(log_joint, reference) - reference


def _wrong_sign(log_joint: Floats, reference: Floats) -> Floats:
    return refresh(log_joint, reference) - 2 * reference


def _no_reference(log_joint: Floats, reference: Floats) -> Floats:
    with np.errstate(all="ignore"):
        return np.log(np.exp(log_joint).sum(axis=0))


def _one_reference(log_joint: Floats, reference: Floats) -> Floats:
    with np.errstate(all="ignore"):
        return reference.max() + np.log(np.exp(log_joint - reference.max()).sum(axis=0))


def _mean_not_sum(log_joint: Floats, reference: Floats) -> Floats:
    return reference + np.log(np.exp(log_joint - reference).mean(axis=0))


def _largest_only(log_joint: Floats, reference: Floats) -> Floats:
    return log_joint.max(axis=0)


def _averaged_covariances(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    share = counts / counts.sum()
    return share @ means, np.tensordot(share, covariances, axes=1)


def _only_between(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    return merge(counts, means, np.zeros_like(covariances))


def _without_counts(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    return merge(np.ones_like(counts), means, covariances)


def _second_moment(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    mean, covariance = merge(counts, means, covariances)
    return mean, covariance + np.outer(mean, mean)


def _less_one(counts: Floats, means: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    mean, covariance = merge(counts, means, covariances)
    return mean, covariance * counts.sum() / (counts.sum() - 1)


register(
    Exercise(
        "ex-13-1",
        _sizes,
        intensity,
        (
            Mistake("a multiply-and-add is two operations; you counted one", _one_operation),
            Mistake("the result is missing: its K N numbers have to be written, too", _without_result),
            Mistake("that is operations for each number; a float64 has 8 bytes", _numbers),
            Mistake("you took 4 bytes for each number; that is float32", _single),
            Mistake("that is bytes for each operation; turn the ratio over", _upside_down),
        ),
    ),
    Exercise(
        "ex-13-2",
        _densities,
        refresh,
        (
            Mistake("that is only the change since the iteration before; add the reference to it again", _change_only),
            Mistake(
                "the reference was taken off before the exponential, so it has to be added, not taken off again",
                _wrong_sign,
            ),
            Mistake(
                "without the reference the exponential overflows or underflows; take it off before np.exp",
                _no_reference,
            ),
            Mistake("each point needs its own reference; one for all leaves the others out of range", _one_reference),
            Mistake("you took the mean over components; the density is their sum", _mean_not_sum),
            Mistake("that is the largest component alone; the density is the sum over all components", _largest_only),
        ),
    ),
    Exercise(
        "ex-13-3",
        _cells,
        merge,
        (
            Mistake(
                "the spread between the cells is missing: average second moments, take off the mean's outer product",
                _averaged_covariances,
            ),
            Mistake("the spread inside the cells is missing: add each cell's own covariance", _only_between),
            Mistake(
                "all cells count the same; a cell of 40 points must count 40 times as much as one of 1", _without_counts
            ),
            Mistake(
                "that is the second moment about the origin; take off the outer product of the mean", _second_moment
            ),
            Mistake("the covariances here are divided by the count, not by the count less one", _less_one),
        ),
    ),
)
