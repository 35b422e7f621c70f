"""Exercises of chapter 7: the Earth Mover's Distance."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def ground(means_p: Floats, means_q: Floats) -> Floats:
    """(K, L) distances between the means of two mixtures, metres."""
    return np.linalg.norm(means_p[:, None] - means_q[None], axis=2)


def balance(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    """Masses and costs with one more place on the lighter side, which takes the rest at cost 0."""
    rest = p.sum() - q.sum()
    if rest > 0:
        return p, np.append(q, rest), np.column_stack([cost, np.zeros(len(p))])
    return np.append(p, -rest), q, np.vstack([cost, np.zeros(len(q))])


def emd_on_a_line(x: Floats, p: Floats, q: Floats) -> float:
    """Work between two distributions on the same rising places x, all (N,)."""
    return float(np.sum(np.abs(np.cumsum(p - q)[:-1]) * np.diff(x)))


def _means() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.normal(size=(4, 3)), rng.normal(size=(2, 3))


def _masses() -> Iterator[tuple[Any, ...]]:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        k, n = 3, 4
        p, q = rng.dirichlet(np.ones(k)), rng.dirichlet(np.ones(n))
        yield (2 * p, 1.4 * q, rng.random((k, n))) if seed % 2 == 0 else (1.2 * p, 2 * q, rng.random((k, n)))


def _lines() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield np.sort(rng.random(7)) * 5, rng.dirichlet(np.ones(7)), rng.dirichlet(np.ones(7))


def _with_slack_cost(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    p, q, full = balance(p, q, cost)
    filled = np.full_like(full, cost.max())
    filled[: cost.shape[0], : cost.shape[1]] = cost
    return p, q, filled


def _on_the_heavier_side(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    rest = p.sum() - q.sum()
    if rest > 0:
        return np.append(p, rest), q, np.vstack([cost, np.zeros(len(q))])
    return p, np.append(q, -rest), np.column_stack([cost, np.zeros(len(p))])


def _always_on_q(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    return p, np.append(q, p.sum() - q.sum()), np.column_stack([cost, np.zeros(len(p))])


def _rest_to_one(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    if p.sum() > q.sum():
        return p, np.append(q, 1 - q.sum()), np.column_stack([cost, np.zeros(len(p))])
    return np.append(p, 1 - p.sum()), q, np.vstack([cost, np.zeros(len(q))])


def _lighter_scaled_up(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    mass = max(p.sum(), q.sum())
    return p / p.sum() * mass, q / q.sum() * mass, cost


def _slack_first(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats, Floats]:
    rest = p.sum() - q.sum()
    if rest > 0:
        return p, np.append(rest, q), np.column_stack([np.zeros(len(p)), cost])
    return np.append(-rest, p), q, np.vstack([np.zeros(len(q)), cost])


register(
    Exercise(
        "ex-07-1",
        _means,
        ground,
        (
            Mistake(
                "those are squared distances, in square metres; take the root at the end",
                lambda p, q: ((p[:, None] - q[None]) ** 2).sum(axis=2),
            ),
            Mistake(
                "rows and columns are swapped: one row for each mean of p, one column for each of q",
                lambda p, q: ground(q, p),
            ),
            Mistake(
                "you added the ways along the axes; the straight way is the root of the sum of squares",
                lambda p, q: np.abs(p[:, None] - q[None]).sum(axis=2),
            ),
            Mistake(
                "that is how much farther out one mean is than the other; take the norm of the difference",
                lambda p, q: np.abs(np.linalg.norm(p, axis=1)[:, None] - np.linalg.norm(q, axis=1)),
            ),
            Mistake(
                "you took the norm along axis=1, the means of q; the coordinates are along the last axis",
                lambda p, q: np.linalg.norm(p[:, None] - q[None], axis=1),
            ),
        ),
    ),
    Exercise(
        "ex-07-2",
        _masses,
        balance,
        (
            Mistake(
                "the slack must cost nothing: what is left over does not travel, so fill in zeros",
                _with_slack_cost,
            ),
            Mistake(
                "the slack is on the heavier side and makes it heavier still; the lighter side needs the place",
                _on_the_heavier_side,
            ),
            Mistake(
                "you always add the place to q; where p is the lighter side, the mass is negative: add a row to p then",
                _always_on_q,
            ),
            Mistake(
                "you scaled both sides to 1: that is mass='normalized', another distance; keep the masses, add a place",
                lambda p, q, cost: (p / p.sum(), q / q.sum(), cost),
            ),
            Mistake(
                "you scaled the lighter side up: then nothing is left over, and E is another distance; keep the "
                "masses, add a place",
                _lighter_scaled_up,
            ),
            Mistake(
                "you filled the lighter side up to 1; fill it up to the mass of the heavier side, which may be any",
                _rest_to_one,
            ),
            Mistake("the new place comes last in line, not first", _slack_first),
        ),
    ),
    Exercise(
        "ex-07-3",
        _lines,
        emd_on_a_line,
        (
            Mistake(
                "without abs, what travels to the left pays for what travels to the right; work is never negative",
                lambda x, p, q: np.sum(np.cumsum(p - q)[:-1] * np.diff(x)),
            ),
            Mistake(
                "the gaps are missing: mass times way; multiply by np.diff(x)",
                lambda x, p, q: np.sum(np.abs(np.cumsum(p - q)[:-1])),
            ),
            Mistake(
                "that is how much is in the wrong place, not how far it goes: sum up along the line, np.cumsum",
                lambda x, p, q: np.sum(np.abs(p - q)) / 2,
            ),
            Mistake(
                "each place sends on all that has piled up so far, not its own difference only: np.cumsum(p - q)",
                lambda x, p, q: np.sum(np.abs(p - q)[:-1] * np.diff(x)),
            ),
            Mistake(
                "that is the distance of the two centres of mass: a lower bound, too small where mass goes both ways",
                lambda x, p, q: abs(np.sum(x * (p - q))),
            ),
        ),
    ),
)
