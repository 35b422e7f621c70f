"""Exercises of chapter 16: seen through, or hidden?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.detection import Bools
from gmmcd_teach.exercises.checking import Exercise, Mistake, register
from gmmcd_teach.lab.shapes import Ints


def looked_past(measured: Floats, depth: Floats, margin: float) -> Bools:
    """(N,) did the pixel measure more than `margin` (m) behind the point? No return (NaN) says nothing."""
    return measured > depth + margin


def answer(near: Bools, past: Bools) -> Ints:
    """(N,) 0 unchanged, 1 changed, 2 unknown."""
    return np.where(near, 0, np.where(past, 1, 2))


def one_step(heat: Floats, links: Floats, up: Floats, down: Floats) -> Floats:
    """(N,) each cell's value from its neighbours (links (N, N)) and its evidence: pull `up` to 1, `down` to 0."""
    return (links @ heat + up) / (links.sum(axis=1) + up + down)


def _depths() -> Iterator[tuple[Floats, Floats, float]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        depth = rng.uniform(1, 2, 12)
        measured = depth + rng.choice([-0.3, -0.01, 0.01, 0.3], 12)
        measured[:4] = depth[:4] + np.array([0.3, -0.3, 0.01, -0.01])
        measured[rng.integers(4, 12, 2)] = np.nan
        yield measured, depth, 0.05


def _evidence() -> Iterator[tuple[Bools, Bools]]:
    yield np.array([True, True, False, False]), np.array([True, False, True, False])


def _graphs() -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        links = rng.uniform(0, 1, (5, 5))
        yield rng.uniform(0, 1, 5), links + links.T, rng.uniform(0, 1, 5), rng.uniform(0, 1, 5)


register(
    Exercise(
        "ex-16-1",
        _depths,
        looked_past,
        (
            Mistake(
                "that is the other way round: something nearer hides the point. Past means that the ray went farther",
                lambda m, d, e: m < d - e,
            ),
            Mistake("noise alone makes half of these true: leave a margin", lambda m, d, e: m > d),
            Mistake(
                "a pixel without return says nothing, yet you count it. Comparisons with NaN are False; use that",
                lambda m, d, e: ~(m <= d + e),
            ),
            Mistake("nearer and farther are not the same: take the sign into account", lambda m, d, e: abs(m - d) > e),
        ),
    ),
    Exercise(
        "ex-16-2",
        _evidence,
        answer,
        (
            Mistake(
                "a point that has a surface near it has stayed, even if one ray slipped past: ask `near` first",
                lambda near, past: np.where(past, 1, np.where(near, 0, 2)),
            ),
            Mistake("what was not looked past may be hidden: unknown, 2", lambda near, past: np.where(near, 0, 1)),
            Mistake("what is neither near nor looked past is unknown, 2", lambda near, past: (past & ~near) * 1),
            Mistake("changed is 1, unknown 2: swapped", lambda n, p: np.where(n, 0, np.where(p, 2, 1))),
        ),
    ),
    Exercise(
        "ex-16-3",
        _graphs,
        one_step,
        (
            Mistake("the evidence is missing: add the pulls", lambda x, w, up, down: w @ x / w.sum(axis=1)),
            Mistake(
                "divide by all that pulls: the links and both kinds of evidence",
                lambda x, w, up, down: (w @ x + up) / w.sum(axis=1),
            ),
            Mistake(
                "the pull down draws towards 0: it belongs into the denominator, and adds 0 above",
                lambda x, w, up, down: (w @ x + up - down) / (w.sum(axis=1) + up + down),
            ),
            Mistake(
                "the links are weights: multiply each neighbour's value by its own",
                lambda x, w, up, down: (x.sum() + up) / (len(x) + up + down),
            ),
        ),
    ),
)
