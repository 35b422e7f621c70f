"""Exercises of chapter 8: greedy extraction."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.emd import emd
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def without(weights: Floats, k: int) -> Floats:
    """(L - 1,) weights without component k, of sum 1."""
    rest = np.delete(weights, k)
    return rest / rest.sum()


def lower_bound(distance: float, prices: Floats, weights: Floats, k: int) -> float:
    """What the EMD cannot fall below when component k is removed."""
    income = prices @ weights
    return float(distance - income + (income - prices[k] * weights[k]) / (1 - weights[k]))


def take_out(
    p: Floats,
    q: Floats,
    cost: Floats,
    *,
    mass: str = "normalized",
    skips_last: bool = False,
    stale: bool = False,
    most: int = 10**6,
    one_too_many: bool = False,
    shrunken: bool = False,
) -> NDArray[np.intp]:
    """Indices into q in the order taken; the options make the usual mistakes."""
    left = list(range(len(q)))
    taken: list[int] = []
    lowest = start = emd(p, q, cost, mass=mass).distance
    while len(left) > 1 and len(taken) < most:
        tried = [
            emd(p, np.delete(q[left], i), np.delete(cost[:, left], i, axis=1), mass=mass).distance
            for i in range(len(left) - skips_last)
        ]
        best = int(np.argmin(tried))
        if tried[best] >= lowest - 1e-12 and not one_too_many:
            break
        if tried[best] >= lowest - 1e-12:
            taken.append(left.pop(best))
            break
        lowest = start if stale and not taken else tried[best]
        k = left.pop(best)
        taken.append(best if shrunken else k)
    return np.array(taken, dtype=np.intp)


def in_one_pass(p: Floats, q: Floats, cost: Floats) -> list[int]:
    """The mistake of trying each removal from the whole mixture, and taking all that lower the EMD."""
    lowest = emd(p, q, cost).distance
    return [k for k in range(len(q)) if emd(p, np.delete(q, k), np.delete(cost, k, axis=1)).distance < lowest]


def _weights() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        yield np.random.default_rng(seed).dirichlet(np.ones(5)), seed + 1


def _bounds() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.uniform(1, 2), rng.normal(size=5), rng.dirichlet(np.ones(5)), seed + 1


def _rooms() -> Iterator[tuple[Any, ...]]:
    """A row of places, slightly moved, and heavy newcomers away from it: one inside the list, or another at its end.

    In the last case nothing is in order, and neither are the five that are taken.
    """
    old = np.column_stack([np.arange(8.0), np.zeros(8)])
    for seed in range(4):
        moved = old + 0.05 * np.random.default_rng(seed).normal(size=old.shape)
        new = np.insert(moved, 3, [2.0, 4.0 + seed], axis=0)
        q = np.insert(np.ones(8), 3, 3.0)
        if seed % 2:
            new, q = np.vstack([new, [6.0, 3.0]]), np.append(q, 1.5)
        yield np.full(8, 1 / 8), q / q.sum(), np.linalg.norm(old[:, None] - new, axis=2)
    rng = np.random.default_rng(1)
    yield rng.dirichlet(np.ones(6)), rng.dirichlet(np.ones(8)), rng.random((6, 8))


register(
    Exercise(
        "ex-08-1",
        _weights,
        without,
        (
            Mistake(
                "the rest does not sum to 1; scale it, or the extraction runs away (P14)",
                lambda w, k: np.delete(w, k),
            ),
            Mistake(
                "you set the weight to 0 and kept the entry; the component has to go: np.delete",
                lambda w, k: np.where(np.arange(len(w)) == k, 0.0, w) / (1 - w[k]),
            ),
            Mistake(
                "you divided by the weight that was taken; divide by what is left, 1 - alpha_k",
                lambda w, k: np.delete(w, k) / w[k],
            ),
            Mistake(
                "you shared the weight out evenly; scaling gives each component in proportion to what it has",
                lambda w, k: np.delete(w, k) + w[k] / (len(w) - 1),
            ),
            Mistake(
                "you took out the first component, not component k",
                lambda w, k: w[1:] / w[1:].sum(),
            ),
        ),
    ),
    Exercise(
        "ex-08-2",
        _bounds,
        lower_bound,
        (
            Mistake(
                "the weights that are left must be scaled: divide the new income by 1 - alpha_k",
                lambda e, v, w, k: e - v @ w + (v @ w - v[k] * w[k]),
            ),
            Mistake(
                "the old income is still in it: take v . alpha off before you add the new income",
                lambda e, v, w, k: e + (v @ w - v[k] * w[k]) / (1 - w[k]),
            ),
            Mistake(
                "component k brings in its price times its weight, v_k alpha_k, not the price alone",
                lambda e, v, w, k: e - v @ w + (v @ w - v[k]) / (1 - w[k]),
            ),
            Mistake(
                "you left the income of component k in; it is gone: take v_k alpha_k off before scaling",
                lambda e, v, w, k: e - v @ w + v @ w / (1 - w[k]),
            ),
            Mistake(
                "you divided by alpha_k; what is left has the weight 1 - alpha_k",
                lambda e, v, w, k: e - v @ w + (v @ w - v[k] * w[k]) / w[k],
            ),
        ),
    ),
    Exercise(
        "ex-08-3",
        _rooms,
        take_out,
        (
            Mistake(
                "the last component is never tried: range(n - 1) stops one short, as in the published code (C1)",
                lambda p, q, cost: take_out(p, q, cost, skips_last=True),
            ),
            Mistake(
                "your second pass is compared with the distance before the first removal (C2); take the last one",
                lambda p, q, cost: take_out(p, q, cost, stale=True),
            ),
            Mistake(
                "with mass='partial' the weights are not scaled after a removal, and the extraction runs away (P14)",
                lambda p, q, cost: take_out(p, q, cost, mass="partial"),
            ),
            Mistake(
                "you stop after one removal; go on until no removal lowers the distance",
                lambda p, q, cost: take_out(p, q, cost, most=1),
            ),
            Mistake(
                "you try all removals from the whole mixture; take the best one out, then try again on what is left",
                in_one_pass,
            ),
            Mistake(
                "the right ones, sorted by index; return them in the order in which they were taken",
                lambda p, q, cost: np.sort(take_out(p, q, cost)),
            ),
            Mistake(
                "the last one taken does not lower the distance: look before you append (P8)",
                lambda p, q, cost: take_out(p, q, cost, one_too_many=True),
            ),
            Mistake(
                "those are places in the list of what was left at that moment; return indices into q",
                lambda p, q, cost: take_out(p, q, cost, shrunken=True),
            ),
        ),
    ),
)
