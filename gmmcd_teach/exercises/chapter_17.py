"""Exercises of chapter 17: what a message weighs, who comes first, and a detector of one's own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


def mixture_bytes(n_components: int, n_dimensions: int) -> int:
    """Bytes of a mixture in single precision: weights, means and halves of the covariances."""
    return 4 * n_components * (1 + n_dimensions + n_dimensions * (n_dimensions + 1) // 2)


def mean_ranks(scores: Floats) -> Floats:
    """(M,) mean place of each method, 1 for the best, from scores (pairs, M) without ties."""
    return 1 + (-scores).argsort(axis=1).argsort(axis=1).mean(axis=0)


def voted(distances: Floats, neighbours: Indices, reach: float) -> Bools:
    """(N,) whether most of each point's neighbours (N, k) are farther than `reach` from the other scan."""
    return (distances[neighbours] > reach).mean(axis=1) > 0.5


def _scores() -> Iterator[tuple[Floats]]:
    for seed in range(3):
        yield (np.random.default_rng(seed).permutation(20).reshape(5, 4) / 20,)


def _clouds() -> Iterator[tuple[Floats, Indices, float]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.exponential(0.03, 30), rng.integers(0, 30, (30, 6)), 0.02


register(
    Exercise(
        "ex-17-1",
        lambda: ((25, 3), (20, 2), (50, 3)),
        mixture_bytes,
        (
            Mistake(
                "a covariance is symmetric: send one half, D (D + 1) / 2 numbers",
                lambda k, d: 4 * k * (1 + d + d * d),
            ),
            Mistake(
                "those are numbers; a number in single precision has 4 bytes", lambda k, d: mixture_bytes(k, d) // 4
            ),
            Mistake("8 bytes are double precision; send single", lambda k, d: 2 * mixture_bytes(k, d)),
            Mistake("the weights are missing", lambda k, d: mixture_bytes(k, d) - 4 * k),
            Mistake("that is one component; there are K", lambda k, d: mixture_bytes(1, d)),
        ),
    ),
    Exercise(
        "ex-17-2",
        _scores,
        mean_ranks,
        (
            Mistake(
                "argsort once tells who is at each place; do it again to get the place of each method",
                lambda x: 1 + (-x).argsort(axis=1).mean(axis=0),
            ),
            Mistake(
                "a high score is good: the largest has place 1", lambda x: 1 + x.argsort(1).argsort(1).mean(axis=0)
            ),
            Mistake("places start at 1, not at 0", lambda x: mean_ranks(x) - 1),
            Mistake(
                "you ranked the mean scores; rank within each pair, then average the places",
                lambda x: 1.0 + (-x.mean(axis=0)).argsort().argsort(),
            ),
            Mistake(
                "you averaged over the methods; one number for each method, so average over the pairs",
                lambda x: (1 + (-x).argsort(1).argsort(1)).mean(axis=1),
            ),
        ),
    ),
    Exercise(
        "ex-17-3",
        _clouds,
        voted,
        (
            Mistake("nobody voted: that is the plain nearest-neighbour detector", lambda x, n, r: x > r),
            Mistake("one vote is not a majority: you took any()", lambda x, n, r: (x[n] > r).any(axis=1)),
            Mistake("you asked for all votes; more than half will do", lambda x, n, r: (x[n] > r).all(axis=1)),
            Mistake(
                "you averaged distances: one far point outvotes many near ones. Let each neighbour say yes or no first",
                lambda x, n, r: x[n].mean(axis=1) > r,
            ),
            Mistake("half is not more than half: use > and not >=", lambda x, n, r: (x[n] > r).mean(axis=1) >= 0.5),
        ),
    ),
)
