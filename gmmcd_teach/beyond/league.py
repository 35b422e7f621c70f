"""The league: every method on the same pairs, scored, timed and weighed (chapter 17).

What the methods are told is fixed here, once, for all scenes. `python -m gmmcd_teach.beyond.league --help` runs the
league over as many seeds as asked.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable
from functools import lru_cache
from time import process_time
from typing import Any

import numpy as np
import pandas as pd

from gmmcd_teach.detection import Detection
from gmmcd_teach.lab import ScenePair, static_pair, tabletop_pair
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS
from gmmcd_teach.methods import METHODS, detect_changes
from gmmcd_teach.study.runs import Row, run
from gmmcd_teach.study.scans import backwards, scan
from gmmcd_teach.study.scores import score
from gmmcd_teach.study.tables import OBJECTS

Method = str | Callable[..., Detection]

OPTIONS: dict[str, Row] = {
    "greedy": {"leaf_size": 0.02},
    "shared": {"alignment_error": 0.02},
    "c2c": {"alignment_error": 0.02},
    "m3c2": {"alignment_error": 0.02, "leaf_size": 0.05, "cylinder_radius": 0.045, "max_depth": 0.045},
    "occupancy": {"alignment_error": 0.02},
}
"""What a method is told on every pair besides its defaults; metres. All that ask are told the same misalignment, about
that of two scans with the pose error of chapter 1. Sizes of cells spare time on dense clouds."""

FRAMES, MAPS = ("cargo_bag", "astrobee", "mixed_frame", "unchanged"), ("two_objects", "three_objects", "mixed")
STATIC = "static_room"
ASK_SENSORS = ("shared", "recommended")  # methods that take where the sensor stood, or its frames
BYTES = {"float": 4, "depth": 2}  # a number of a cloud or a mixture, and a depth in steps of a millimetre


def league_pair(scene: str, seed: int = 0) -> ScenePair:
    """A simulated pair, a real table-top pair or the static room, by its name; the seed is for simulated ones.

    Raises
    ------
    ValueError
        No such scene.
    CloudError
        A real scan that is not at hand.

    Examples
    --------
    >>> league_pair("cargo_bag", 1).name
    'cargo_bag'
    """
    if scene not in (*TABLETOP_PAIRS, STATIC):
        return scan(scene, seed)
    return real_pair(scene, os.environ.get("GMMCD_TEACH_DATA"))


@lru_cache(maxsize=1)
def real_pair(name: str, folder: str | None) -> ScenePair:
    """A real pair, kept while the methods take their turns on it."""
    return static_pair(folder) if name == STATIC else tabletop_pair(name, folder)


def sensors(pair: ScenePair) -> Row:
    """What methods that ask are told: the depth frames of a simulated pair, where the camera stood in a real one.

    Examples
    --------
    >>> sorted(sensors(league_pair("cargo_bag", 1)))
    ['after_frames', 'before_frames']
    """
    if pair.name in (*TABLETOP_PAIRS, STATIC):
        return {f"{side}_origin": getattr(pair, f"{side}_frames")[0].pose[:3, 3] for side in ("before", "after")}
    return {"before_frames": pair.before_frames, "after_frames": pair.after_frames}


def payload(pair: ScenePair, detection: Detection) -> dict[str, int]:
    """Bytes of the later scan, not compressed, in the three forms in which a robot could send it.

    A mixture is K weights, means and halves of covariances, a cloud N points, all in single precision; frames are
    depths of two bytes, with a pose and intrinsics each. A detection without a mixture has none to send: 0.

    Examples
    --------
    >>> pair = league_pair("cargo_bag", 1)
    >>> payload(pair, Detection(pair.appeared, pair.disappeared))["frames"]  # 224 x 172 depths, 16 numbers
    77120
    """
    mixture, d = detection.after_mixture, pair.after.shape[1]
    numbers = 0 if mixture is None else mixture.n_components * (1 + d + d * (d + 1) // 2)
    frames = sum(BYTES["depth"] * frame.depth.size + BYTES["float"] * (12 + 4) for frame in pair.after_frames)
    return {"mixture": BYTES["float"] * numbers, "cloud": BYTES["float"] * pair.after.size, "frames": frames}


def league_runs(
    method: Method, scene: str, seed: int = 0, *, order: str = "forward", sensor: bool = True, **options: Any
) -> list[Row]:
    """Let one method answer for one pair: what `study.run` calls for each row of the league.

    Parameters
    ----------
    method : a key of METHODS, or a function `detect(before, after, **options) -> Detection`.
    scene, seed : see `league_pair`.
    order : "forward", or "backward" for the two scans exchanged.
    sensor : tell the methods that ask what the sensor saw.
    **options : besides those of OPTIONS.

    Returns
    -------
    The rows of `score` for both directions, each with `cpu` (seconds), `claimed` (share of the points), `mixture`,
    `cloud`, `frames` (bytes, see `payload`) and `sent`, the bytes of the form that this method asks for.

    Raises
    ------
    ValueError
        An unknown method, scene or order.

    Examples
    --------
    >>> [row["level"] for row in league_runs("occupancy", "cargo_bag", 1)]
    ['point', 'object', 'point', 'object']
    """
    if order not in ("forward", "backward"):
        raise ValueError(f"order = {order!r}; expected 'forward' or 'backward'")
    pair = league_pair(scene, seed)
    return answer(method, pair if order == "forward" else backwards(pair), seed, sensor=sensor, **options)


def answer(method: Method, pair: ScenePair, seed: Any = 0, *, sensor: bool = True, **options: Any) -> list[Row]:
    """The rows of `league_runs` for a pair that is at hand."""
    known = method if isinstance(method, str) else ""
    told = sensors(pair) if sensor and known in ASK_SENSORS else {}
    told |= {**OPTIONS.get(known, {}), **options}
    start = process_time()
    if callable(method):
        detection = method(pair.before, pair.after, **told)
    else:
        detection = detect_changes(pair.before, pair.after, method=method, rng=np.random.default_rng(seed), **told)
    cpu, weights = process_time() - start, payload(pair, detection)
    form = "mixture" if known == "greedy" else "frames" if "after_frames" in told else "cloud"
    claimed = {"appeared": detection.appeared.mean(), "disappeared": detection.disappeared.mean()}
    labels = {"cpu": cpu, **weights, "sent": weights[form]}
    return [{**row, "claimed": claimed[row["direction"]], **labels} for row in score(detection, pair)]


def complaints(detect: Callable[..., Detection]) -> list[str]:
    """What keeps a function of your own out of the league; nothing if it may play.

    Examples
    --------
    >>> complaints(lambda before, after: Detection(np.zeros(90, bool), np.zeros(90, bool)))
    ['appeared: shape (90,); expected (100,), one answer for each point of `after`']
    """
    rng = np.random.default_rng(0)
    before, after = rng.uniform(0, 1, (90, 3)), rng.uniform(0, 1, (100, 3))
    copies = before.copy(), after.copy()
    found = detect(before, after)
    if not isinstance(found, Detection):
        return [f"a {type(found).__name__} came back; expected Detection(appeared, disappeared)"]
    says = []
    for name, cloud, word in (("appeared", after, "after"), ("disappeared", before, "before")):
        flags = np.asarray(getattr(found, name))
        if flags.shape != (len(cloud),):
            says.append(f"{name}: shape {flags.shape}; expected ({len(cloud)},), one answer for each point of `{word}`")
        elif flags.dtype != bool:
            says.append(f"{name}: {flags.dtype}; expected bool")
    if not (np.array_equal(before, copies[0]) and np.array_equal(after, copies[1])):
        says.append("the clouds were changed in place; work on copies")
    again = detect(*copies)
    same = (np.array_equal(getattr(found, name), getattr(again, name)) for name in ("appeared", "disappeared"))
    if not says and not all(same):
        says.append("the same clouds gave two answers; take random numbers from a generator with a fixed seed")
    return says


def entries(
    seeds: Iterable[int], map_seeds: Iterable[int] = (), real: bool = False, methods: Iterable[str] = tuple(METHODS)
) -> list[Row]:
    """The calls of `league_runs` that make a league, for `study.run`.

    The paper's scenes are also played backward, by the methods that ask for sensors: the baselines give the same
    answers in either order, and the greedy method is two runs in one (chapter 10). `real` adds the table-top pairs
    and the static room.

    Examples
    --------
    >>> len(entries([0], methods=["c2c"])), len(entries([0], methods=["shared"]))
    (4, 6)
    """
    places = [(scene, seed) for seed in seeds for scene in FRAMES]
    places += [(scene, seed) for seed in map_seeds for scene in MAPS]
    places += [(name, 0) for name in (*TABLETOP_PAIRS, STATIC) if real]
    return [
        {"method": method, "scene": scene, "seed": seed, "order": order}
        for scene, seed in places
        for order in ("forward", "backward")
        for method in methods
        if order == "forward" or (scene in OBJECTS and method in ASK_SENSORS)
    ]


def main() -> None:
    """Run the league from the command line, and write its rows as .csv."""
    parser = argparse.ArgumentParser(prog="python -m gmmcd_teach.beyond.league", description=main.__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="single frames are taken with seeds 0 to N - 1")
    parser.add_argument("--map-seeds", type=int, default=2, help="maps likewise; each takes some ten seconds to scan")
    parser.add_argument("--real", action="store_true", help="the real scans, too")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", default="league.csv", help="file for the rows")
    options = parser.parse_args()
    jobs = entries(range(options.seeds), range(options.map_seeds), options.real)
    table: pd.DataFrame = run(league_runs, jobs, n_jobs=options.jobs)
    table.to_csv(options.out, index=False)


if __name__ == "__main__":
    from gmmcd_teach.beyond.league import main as of_the_package  # whose rows are kept, as those of __main__ are not

    of_the_package()
