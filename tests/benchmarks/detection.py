"""`detect_changes` on single frames beside 25 iterations of scikit-learn, and on a map, for each point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import numpy as np

from gmmcd_teach import detect_changes
from gmmcd_teach.detection import Detection
from gmmcd_teach.lab import ScenePair
from gmmcd_teach.study import scan
from tests.benchmarks.iteration import scikit
from tests.benchmarks.timing import Ratio, medians


def measure(quick: bool) -> Iterator[Ratio]:
    """Two lines for the frames, the second on cells first, and one for the map; each call starts EM anew."""
    k = 5 if quick else 25
    frames = scan("cargo_bag", 0)
    larger = frames if quick else scan("two_objects", 0)
    seconds = medians(
        {
            "scikit-learn": scikit(k, frames.after - np.median(frames.after, axis=0)),
            "frames": detecting(frames, k),
            "cells": detecting(frames, k, cell_size=0.025),
            "map": detecting(larger, k),
        },
        1 if quick else 5,
    )
    for name, clouds in (("frames", "single frames"), ("cells", "frames, cells of 25 mm")):
        share = seconds[name] / (25 * seconds["scikit-learn"])
        yield Ratio(f"{clouds}: time of 25 scikit-learn iterations", share, 1.0, at_most=True)
    per_point = (seconds["map"] / n_points(larger)) / (seconds["frames"] / n_points(frames))
    yield Ratio("map: time for each point, times that of the frames", per_point, 1.3, at_most=True)


def detecting(pair: ScenePair, k: int, **options: Any) -> Callable[[], Detection]:
    """`detect_changes` on all points of a pair, with a new seed at each call."""
    seeds = count()
    return lambda: detect_changes(pair.before, pair.after, max_components=k, rng=next(seeds), **options)


def n_points(pair: ScenePair) -> int:
    """Points of both scans."""
    return len(pair.before) + len(pair.after)
