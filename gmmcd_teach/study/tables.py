"""The paper's table of metrics, measured anew, and what means over runs can explain in it (chapter 10)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from gmmcd_teach.methods import detect_changes
from gmmcd_teach.study.intervals import summary
from gmmcd_teach.study.scans import backwards, scan
from gmmcd_teach.study.scores import METRICS, Row, objects_found, score

PUBLISHED_METRICS = pd.DataFrame(
    {"one": [0.953, 0.600, 1.000, 0.727], "two": [0.929, 0.617, 0.667, 0.650], "three": [0.952, 0.933, 0.750, 0.829]},
    index=pd.Index(METRICS, name="metric"),
)
"""The paper's table of metrics: appearances, counted on components, by the number of objects that appeared."""

OBJECTS = {"cargo_bag": "one", "astrobee": "one", "two_objects": "two", "three_objects": "three"}
"""Scene -> column of the paper's table."""

Tables = Mapping[str, pd.DataFrame]
"""Name -> table of runs, see `measured`."""

FORWARD = {"order": "forward", "direction": "appeared"}
"""Rows of `metric_runs` on what has come, asked for in the order of time."""

OVERLAP = 0.1
"""Share of changed points from which a component "overlaps" a change; the paper gives no number."""


def metric_runs(scene: str, seed: int, starts: int = 1, **options: Any) -> list[Row]:
    """Detect and score one pair of scans in both orders of time, each from `starts` random starts of EM.

    Forward, the scenes of the paper hold appearances only; backward, disappearances only. The other direction has
    nothing to find: all its claims are false.

    Parameters
    ----------
    scene, seed : see `simulate_pair`.
    starts : how many times EM starts anew on the same scans.
    **options : see `detect_changes`.

    Returns
    -------
    The rows of `score`, and components counted by the paper's word, `level` "overlap": changed where more than
    `OVERLAP` of the points have. Besides `objects`, `start`, `order` ("forward", "backward"), `n_components` of the
    mixture that is scored, and what `objects_found` says of the direction's claimed points.

    Examples
    --------
    >>> rows = metric_runs("cargo_bag", 1, leaf_size=0.1, max_components=5)
    >>> sorted({(row["order"], row["direction"]) for row in rows if row["tp"] + row["fn"] > 0})
    [('backward', 'disappeared'), ('forward', 'appeared')]
    """
    rows = []
    forward = scan(scene, seed, frames=False)
    for order, pair in {"forward": forward, "backward": backwards(forward)}.items():
        for start in range(starts):
            rng = np.random.default_rng([seed, start, int(order == "backward")])
            detection = detect_changes(pair.before, pair.after, rng=rng, **options)
            labels = {"objects": OBJECTS.get(scene, scene), "start": start, "order": order}
            found = score(detection, pair, overlap=OVERLAP)
            for direction, mixture, claimed, numbers in (
                ("appeared", detection.after_mixture, detection.appeared, pair.after_objects),
                ("disappeared", detection.before_mixture, detection.disappeared, pair.before_objects),
            ):
                labels |= {"n_components": getattr(mixture, "n_components", 0)}
                labels |= objects_found(claimed, numbers, pair.object_names)
                rows += [{**labels, **row} for row in found if row["direction"] == direction]
    return rows


def metric_table(runs: pd.DataFrame, level: str = "component") -> pd.DataFrame:
    """The paper's table of metrics beside ours: mean and 95 % t-interval over scans, for both directions.

    Parameters
    ----------
    runs : from `run(metric_runs, ...)`.
    level : "component", "overlap", "point" or "object"; the paper's values are for components.

    Returns
    -------
    Tidy: `objects`, `direction`, `metric`, `paper` (appearances on components only, else NaN), `mean`, `low`, `high`,
    `n`, the scans in which the metric was defined. Starts of EM on one scan are averaged first, see `scan_means`.

    Raises
    ------
    ValueError
        No rows of that level.

    Examples
    --------
    >>> from gmmcd_teach.study.runs import run
    >>> runs = run(metric_runs, [{"scene": "cargo_bag", "seed": 1, "leaf_size": 0.1, "max_components": 5}])
    >>> metric_table(runs)["paper"].tolist()[:4]
    [0.953, 0.6, 1.0, 0.727]
    """
    asked = runs[(runs["level"] == level) & ((runs["order"] == "forward") == (runs["direction"] == "appeared"))]
    if asked.empty:
        raise ValueError(f"level = {level!r}; expected one of {', '.join(map(repr, runs['level'].unique()))}")
    scans = scan_means(asked, ["objects", "direction"], METRICS)
    table = summary(scans, ["objects", "direction"], METRICS, within=(0, 1))
    known = PUBLISHED_METRICS.to_dict() if level in ("component", "overlap") else {}
    keys = zip(table["objects"], table["direction"], table["metric"], strict=True)
    printed = [known.get(o, {}).get(m, np.nan) if d == "appeared" else np.nan for o, d, m in keys]
    table.insert(3, "paper", printed)
    return table


def scan_means(runs: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Means over the runs on each scan, so that each scan counts once: starts of EM on one scan are not independent.

    Parameters
    ----------
    runs : one row for each run, with `scene` and `seed`.
    by : columns that tell apart what is not to be averaged.
    columns : what to average; NaN is left out.

    Returns
    -------
    One row for each scan and group: `scene`, `seed`, `by`, `columns`.

    Examples
    --------
    >>> runs = pd.DataFrame({"scene": "a", "seed": [0, 0, 1], "f1": [0.0, 1.0, 0.25]})
    >>> scan_means(runs, [], ["f1"])["f1"].tolist()
    [0.5, 0.25]
    """
    return runs.groupby(["scene", "seed", *by], sort=False)[list(columns)].mean().reset_index()


def at(table: pd.DataFrame, level: str = "point", **where: object) -> pd.DataFrame:
    """The rows of a level, and of given values in other columns.

    Examples
    --------
    >>> at(pd.DataFrame({"level": ["point", "object"], "f1": [0.2, 0.4]}), "object")["f1"].tolist()
    [0.4]
    """
    rows = table[table["level"] == level]
    for column, value in where.items():
        rows = rows[rows[column] == value]
    return rows


def appeared(tables: Tables, metric: str, objects: str) -> pd.Series[float]:
    """The metric of each scan with so many objects, counted on components as the paper does: the mean over starts.

    Examples
    --------
    >>> labels = {"level": "component", "order": "forward", "direction": "appeared", "scene": "two_objects", "seed": 0}
    >>> runs = pd.DataFrame([labels | {"objects": "two", "f1": f1} for f1 in (0.25, 0.75)])
    >>> appeared({"metrics": runs}, "f1", "two").tolist()
    [0.5]
    """
    rows = at(tables["metrics"], "component", objects=objects, **FORWARD)
    return scan_means(rows, [], [metric])[metric]


def harmonic_bounds(precision: float, recall: float, rounding: float = 0.0) -> tuple[float, float]:
    """The least and the largest mean F1 that runs of this mean precision and mean recall can have.

    F1 is the harmonic mean, concave in (precision, recall): the mean of many is at most that of their means (Jensen),
    and at least 0 and precision + recall - 1, the plane through its values at three corners of the unit square.

    Parameters
    ----------
    precision, recall : means over runs, 0 to 1.
    rounding : how far each may be from what is printed, 0.0005 for three digits.

    Examples
    --------
    >>> [round(bound, 3) for bound in harmonic_bounds(0.6, 1.0)]
    [0.6, 0.75]
    """
    low, high = (np.clip([precision + step, recall + step], 0, 1) for step in (-rounding, rounding))
    return max(0.0, float(low.sum() - 1)), float(2 * high.prod() / high.sum()) if high.any() else 0.0
