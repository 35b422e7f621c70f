"""Exercises of chapter 11: an exponent from a table of times, choices that nothing beats, fragments made one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


def exponent(x: Floats, y: Floats) -> float:
    """b of y = a x^b, by least squares on the logarithms."""
    u, v = np.log(x), np.log(y)
    u, v = u - u.mean(), v - v.mean()
    return float((u * v).sum() / (u * u).sum())


def unbeaten(seconds: Floats, score: Floats) -> Bools:
    """Choices that no other beats: none is as quick and as good, and quicker or better."""
    s, f = seconds[:, None], score[:, None]  # (n, 1): those that are beaten; (n,): those that beat
    beaten = ((seconds <= s) & (score >= f) & ((seconds < s) | (score > f))).any(axis=1)
    return np.asarray(~beaten)


def group_numbers(centres: Floats, reach: float, *, chain: bool = True, squared: bool = False) -> Ints:
    """Number of the group of each centre, from 0 on in the order in which they come; near ones share a group."""
    distance = ((centres[:, None] - centres) ** 2).sum(axis=2)  # (R, R)
    near = (distance if squared else np.sqrt(distance)) <= reach
    number = np.full(len(centres), -1)
    for first in range(len(centres)):
        if number[first] >= 0:
            continue
        group = near[first] & (number < 0)
        while chain and (grown := (near[group].any(axis=0) & (number < 0))).sum() > group.sum():
            group = grown
        number[group] = number.max() + 1
    return number


def _times() -> Iterator[tuple[Any, ...]]:
    rng = np.random.default_rng(0)
    for b in (1.0, 1.4, 2.0):
        k = np.array([10.0, 15, 20, 25, 30, 40, 50])
        yield k, 0.03 * k**b * np.exp(rng.normal(0, 0.1, len(k)))


def _choices() -> Iterator[tuple[Any, ...]]:
    yield np.array([1.0, 2, 3, 4, 5]), np.array([0.2, 0.5, 0.4, 0.7, 0.7])
    yield np.array([3.0, 1, 2, 2, 4]), np.array([0.6, 0.3, 0.3, 0.4, 0.6])
    yield np.array([2.0, 2, 1]), np.array([0.5, 0.5, 0.1])  # two that are the same: neither beats the other
    rng = np.random.default_rng(1)
    yield rng.random(12), rng.random(12)


def _centres() -> Iterator[tuple[Any, ...]]:
    yield np.array([[0.0, 0, 0], [2.0, 0, 0], [0.2, 0, 0], [0.4, 0, 0], [2.2, 0, 0]]), 0.25  # a chain
    yield np.array([[1.0, 1, 1], [1.0, 1, 1.3], [0.0, 0, 0]]), 0.3 + 1e-9
    rng = np.random.default_rng(2)
    yield 3 * rng.random((14, 3)), 0.8


register(
    Exercise(
        "ex-11-1",
        _times,
        exponent,
        (
            Mistake(
                "that is the slope of a straight line through y and x; take the logarithm of both first",
                lambda x, y: np.polyfit(x, y, 1)[0],
            ),
            Mistake(
                "you took the logarithm of y only; that fits an exponential, not a power. Take log(x), too",
                lambda x, y: np.polyfit(x, np.log(y), 1)[0],
            ),
            Mistake(
                "x and y are exchanged: that is the exponent of x as a power of y",
                lambda x, y: exponent(y, x),
            ),
            Mistake(
                "that is log a, the offset of the line; the exponent is its slope, the first number of np.polyfit",
                lambda x, y: np.polyfit(np.log(x), np.log(y), 1)[1],
            ),
            Mistake(
                "that line goes through the first and the last point only; fit all of them",
                lambda x, y: np.log(y[-1] / y[0]) / np.log(x[-1] / x[0]),
            ),
            Mistake(
                "without subtracting the means the line is forced through 0; subtract them from both logarithms",
                lambda x, y: (np.log(x) * np.log(y)).sum() / (np.log(x) ** 2).sum(),
            ),
        ),
    ),
    Exercise(
        "ex-11-2",
        _choices,
        unbeaten,
        (
            Mistake(
                "that keeps those which are slower and worse: more seconds are bad, more F1 is good",
                lambda seconds, score: unbeaten(-seconds, -score),
            ),
            Mistake(
                "you took both for costs; a high F1 is good: turn its comparison around",
                lambda seconds, score: unbeaten(seconds, -score),
            ),
            Mistake(
                "a choice is beaten, too, by one that is as quick and better: allow <= in one, ask < in the other",
                lambda seconds, score: ~((seconds < seconds[:, None]) & (score > score[:, None])).any(axis=1),
            ),
            Mistake(
                "with <= and >= alone each choice beats itself; ask that it is quicker or better in one of the two",
                lambda seconds, score: ~((seconds <= seconds[:, None]) & (score >= score[:, None])).any(axis=1),
            ),
            Mistake(
                "the best F1 alone is not all: a quicker choice with a lower F1 is unbeaten as well",
                lambda seconds, score: score == score.max(),
            ),
        ),
    ),
    Exercise(
        "ex-11-3",
        _centres,
        group_numbers,
        (
            Mistake(
                "groups grow by chains: where a is near b and b near c, all three are one, even if a is far from c",
                lambda centres, reach: group_numbers(centres, reach, chain=False),
            ),
            Mistake(
                "you compare the squared distance with reach; take the square root first",
                lambda centres, reach: group_numbers(centres, reach, squared=True),
            ),
            Mistake(
                "you measure along the first axis only; the distance has all axes in it",
                lambda centres, reach: group_numbers(centres[:, :1], reach),
            ),
            Mistake(
                "each centre has a group of its own; give near ones the same number",
                lambda centres, reach: np.arange(len(centres)),
            ),
            Mistake(
                "the numbers start at 0, in the order in which the groups come",
                lambda centres, reach: group_numbers(centres, reach) + 1,
            ),
        ),
    ),
)
