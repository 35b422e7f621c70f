"""`detect_changes` on single frames beside 25 iterations of scikit-learn, and on a map, for each point."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach import detect_changes
from gmmcd_teach.study import scan
from tests.benchmarks.iteration import scikit
from tests.benchmarks.timing import Ratio, cpu_seconds, medians


def measure(quick: bool) -> Iterator[Ratio]:
    """A line for the frames and one for the map."""
    k, repeats = (5, 1) if quick else (25, 5)
    frames = scan("cargo_bag", 0)
    points = frames.after - np.median(frames.after, axis=0)
    iteration = medians({"scikit-learn": scikit(k, points)}, 1 if quick else 11)["scikit-learn"]
    per_point = {}
    for name, pair in (("frame", frames), ("map", frames if quick else scan("two_objects", 0))):
        seeds = range(repeats)
        took = [
            cpu_seconds(lambda p=pair, s=seed: detect_changes(p.before, p.after, max_components=k, rng=s))[0]
            for seed in seeds
        ]
        per_point[name] = np.median(took) / (len(pair.before) + len(pair.after))
        if name == "frame":
            yield Ratio(
                "single frames: time of 25 scikit-learn iterations", np.median(took) / (25 * iteration), 1.0, True
            )
    yield Ratio("map: time for each point, times that of the frames", per_point["map"] / per_point["frame"], 1.3, True)
