"""Exercises of chapter 1: point clouds."""

from __future__ import annotations

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def extent(points: Floats) -> Floats:
    """(D,) size of the cloud along each axis, metres."""
    return points.max(axis=0) - points.min(axis=0)


register(
    Exercise(
        "ex-01-1",
        lambda: ((np.random.default_rng(seed).normal(size=(9, 3)),) for seed in range(3)),
        extent,
        (
            Mistake("you went along the wrong axis: rows are points, so take axis=0", lambda s: np.ptp(s, axis=1)),
            Mistake(
                "that is one number for the whole cloud; say axis=0 to get one for each column", lambda s: np.ptp(s)
            ),
            Mistake("that is the largest coordinate; take the smallest one off it", lambda s: s.max(axis=0)),
            Mistake("the sign is turned around: largest minus smallest", lambda s: s.min(axis=0) - s.max(axis=0)),
        ),
    )
)
