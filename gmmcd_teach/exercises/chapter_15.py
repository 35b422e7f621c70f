"""Exercises of chapter 15: one mixture for both clouds."""

from __future__ import annotations

from collections.abc import Iterator
from math import comb

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def share_of_after(n_before: Floats, n_after: Floats) -> Floats:
    """(K,) share of each component's patches that come from the later cloud."""
    return n_after / (n_before + n_after)


def with_floor(covariances: Floats, alignment_error: float) -> Floats:
    """(K, D, D) covariances, none thinner than the alignment error (metres)."""
    return covariances + alignment_error**2 * np.eye(covariances.shape[-1])


def chance_of_so_few(n_few: int, n_total: int) -> float:
    """Chance that at most n_few of n_total patches come from one cloud, each cloud being as likely."""
    return sum(comb(n_total, j) for j in range(n_few + 1)) / 2**n_total


def _counts() -> Iterator[tuple[Floats, Floats]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.integers(1, 30, 6).astype(float), rng.integers(0, 50, 6).astype(float)


def _covariances() -> Iterator[tuple[Floats, float]]:
    for seed in range(3):
        root = np.random.default_rng(seed).normal(0, 0.1, (4, 3, 3))
        yield root @ root.swapaxes(1, 2), 0.02 + 0.01 * seed


def _on_the_diagonal(covariances: Floats, alignment_error: float) -> Floats:
    floored = covariances.copy()
    for k in range(covariances.shape[-1]):
        floored[:, k, k] = np.maximum(floored[:, k, k], alignment_error**2)
    return floored


register(
    Exercise(
        "ex-15-1",
        _counts,
        share_of_after,
        (
            Mistake("that is the ratio of the two; a share is a part of the whole", lambda b, a: a / b),
            Mistake("that is the share of the earlier cloud; the later one was asked for", lambda b, a: b / (a + b)),
            Mistake(
                "you divided by all patches of the later cloud; each component is asked for itself",
                lambda b, a: a / a.sum(),
            ),
            Mistake("that is a difference; divide the later count by the sum", lambda b, a: a - b),
        ),
    ),
    Exercise(
        "ex-15-2",
        _covariances,
        with_floor,
        (
            Mistake("a covariance is in square metres: square the error first", lambda c, e: c + e * np.eye(3)),
            Mistake(
                "you added it to every entry; multiply by np.eye(D) first",
                lambda c, e: c + e**2,
            ),
            Mistake(
                "a component that lies askew is thin though its diagonal is large: add",
                _on_the_diagonal,
            ),
            Mistake("you put the floor in place of the covariances; add it", lambda c, e: 0 * c + e**2 * np.eye(3)),
        ),
    ),
    Exercise(
        "ex-15-3",
        lambda: ((2, 10), (0, 8), (7, 20)),
        chance_of_so_few,
        (
            Mistake(
                "that is the chance of exactly so few; fewer would be stranger still, so they count, too",
                lambda few, n: comb(n, few) / 2**n,
            ),
            Mistake(
                "the last term is missing: range(n_few + 1) goes up to n_few",
                lambda few, n: sum(comb(n, j) for j in range(few)) / 2**n,
            ),
            Mistake("that is the chance of more than so few", lambda few, n: 1 - chance_of_so_few(few, n)),
            Mistake("divide by 2**n_total, the number of all outcomes", lambda few, n: chance_of_so_few(few, n) * 2**n),
        ),
    ),
)
