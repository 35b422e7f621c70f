"""What the paper claims, and by which rule each claim is judged: written before the numbers (appendix C)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gmmcd_teach.study.intervals import Interval
from gmmcd_teach.study.runtime import PUBLISHED_RUNTIME
from gmmcd_teach.study.tables import PUBLISHED_METRICS

REPRODUCED, NOT_REPRODUCED, NOT_COMPARABLE = "reproduced", "not reproduced", "not comparable"
VERDICTS = (REPRODUCED, NOT_REPRODUCED, NOT_COMPARABLE)
FEWEST = 5
"""Scans, or values of K, below which an interval of a mean decides nothing."""
Value = float | tuple[float, float] | None


@dataclass(frozen=True)
class Rule:
    """How a claim is judged: in words, and as a function of the paper's value and our interval."""

    words: str
    holds: Callable[[Value, Interval], bool | None]


@dataclass(frozen=True)
class Claim:
    """One claim of the paper.

    Attributes
    ----------
    name : short, unique.
    where : section or table of the paper.
    says : the claim, in our words.
    value : the paper's number, or range; None where it gives none.
    rule : key of `RULES`.
    measured : what our number is.
    unit : what is independent, and counted: "scans", each the mean of its runs, or "values of K" on one scan.
    """

    name: str
    where: str
    says: str
    value: Value
    rule: str
    measured: str
    unit: str = "scans"


def _within(value: Value, ours: Interval, rounding: float) -> bool:
    assert isinstance(value, float)
    return ours.low - rounding <= value <= ours.high + rounding


def _inside(value: Value, ours: Interval) -> bool:
    assert isinstance(value, tuple)
    return value[0] <= ours.low and ours.high <= value[1]


def _above(value: Value, ours: Interval) -> bool:
    assert isinstance(value, float)
    return ours.low > value


RULES = {
    "value": Rule(
        "reproduced if the paper's value, as rounded, lies in our interval",
        lambda value, ours: _within(value, ours, 0.0005),
    ),
    "percent": Rule(
        "reproduced if the paper's value, rounded to a percent, lies in our interval",
        lambda value, ours: _within(value, ours, 0.005),
    ),
    "range": Rule("reproduced if our interval lies in the paper's range", _inside),
    "similar": Rule("reproduced if our interval of the difference lies within -0.1 to 0.1", _inside),
    "linear": Rule("reproduced if our interval of the exponent lies within 0.75 to 1.25", _inside),
    "most": Rule(
        "reproduced if it happens in more than half of our scans: the interval of the share is above 0.5", _above
    ),
    "above": Rule("reproduced if our interval lies above 0; EM's share: above 0.5", _above),
    "seconds": Rule("never comparable: seconds of another computer, on other clouds", lambda value, ours: None),
    "open": Rule("not comparable: the paper names it, and gives no value", lambda value, ours: None),
}
"""Rule of each kind of claim."""


def too_few(claim: Claim, ours: Interval) -> bool:
    """Are there fewer than `FEWEST` values behind a rule that asks for an interval?

    Examples
    --------
    >>> too_few(Claim("x", "Table", "Accuracy", 0.95, "value", "mean"), Interval(0.9, 0.8, 1.0, 2))
    True
    """
    return claim.rule not in ("seconds", "open") and ours.n < FEWEST


def verdict(claim: Claim, ours: Interval) -> str:
    """One of `VERDICTS`, by the claim's rule; not comparable where there are `too_few` scans to tell.

    Raises
    ------
    ValueError
        There is no measurement: the mean is NaN.

    Examples
    --------
    >>> verdict(Claim("x", "Table", "Accuracy", 0.95, "value", "mean"), Interval(0.9, 0.8, 1.0, 10))
    'reproduced'
    """
    if ours.n == 0 or ours.mean != ours.mean:
        raise ValueError(f"claim {claim.name!r} has no measurement")
    holds = None if too_few(claim, ours) else RULES[claim.rule].holds(claim.value, ours)
    return NOT_COMPARABLE if holds is None else REPRODUCED if holds else NOT_REPRODUCED


_STEPS = {"load": "loading", "pca": "PCA", "em": "EM", "emd": "EMD", "total": "in total"}
_NAMES = {"accuracy": "accuracy", "precision": "precision", "recall": "recall", "f1": "F1"}
_OBJECTS = {"one": ", one object", "two": ", two objects", "three": ", three objects"}
_SIMILAR, _LINEAR = (-0.1, 0.1), (0.75, 1.25)
_RUNTIME, _FRAMES, _MAPS = "Runtime", "Single Frame Point Clouds", "Reconstructed Maps"
_VARIATIONS, _METRICS, _FUTURE = "Algorithm Variations", "Performance Metrics", "Future Work"

CLAIMS: tuple[Claim, ...] = (
    *(
        Claim(f"time-{k}-{step}", "Table of runtimes", f"K = {k}, {_STEPS[step]} [s]", float(row[step]), "seconds",
              "seconds of computing", "runs")
        for k, row in PUBLISHED_RUNTIME.iterrows()
        for step in PUBLISHED_RUNTIME.columns
    ),
    Claim("em-dominates", _RUNTIME, "EM accounts for most of the run time", 0.5, "above",
          "EM's share of the time", "values of K"),
    Claim("linear-in-k", _RUNTIME, "EM's time grows about linearly with K", _LINEAR, "linear",
          "exponent b of time = a K^b", "values of K"),
    *(
        Claim(f"{metric}-{objects}", "Table of metrics", _NAMES[metric] + _OBJECTS[objects],
              float(PUBLISHED_METRICS.loc[metric, objects]), "value", "mean over scans, counted on components")
        for objects in PUBLISHED_METRICS.columns
        for metric in PUBLISHED_METRICS.index
    ),
    Claim("recall-best-one", _METRICS, "recall is highest for one object", 0.0, "above",
          "one object, less the better of two and three"),
    Claim("precision-best-three", _METRICS, "precision is highest for three objects", 0.0, "above",
          "three objects, less the better of one and two"),
    Claim("f1-best-three", _METRICS, "F1 is highest for three objects", 0.0, "above",
          "three objects, less the better of one and two"),
    Claim("f1-one-over-two", _METRICS, "F1 for one object is above that for two", 0.0, "above",
          "one object, less two"),
    Claim("disappearances-similar", _METRICS, "scores are similar for disappearances", _SIMILAR, "similar",
          "F1 forward, less backward, on the same scans"),
    Claim("k-star", _FRAMES, "K* is 20 to 23 for K = 25", (20.0, 23.0), "range",
          "mean K* of single frames, both fits of each"),
    Claim("frame-found", _FRAMES, "the object is found", 0.5, "most", "share of scans in which it is"),
    Claim("frame-clean", _FRAMES, "no object is falsely found", 0.5, "most", "share of scans without a false object"),
    Claim("map-two-found", _MAPS, "both objects of the two-object map are found", 0.5, "most",
          "share of scans in which both are"),
    Claim("map-three-found", _MAPS, "crate and cargo bag of the three-object map are found", 0.5, "most",
          "share of scans in which both are"),
    Claim("docked-missed", _MAPS, "the Astrobee on its dock is missed", 0.5, "most", "share of scans in which it is"),
    Claim("k10-missed", _VARIATIONS, "at K = 10 the cargo bag melts into the wall and is missed", 0.5, "most",
          "share of scans in which it is missed"),
    Claim("area-shrinks", _VARIATIONS, "the detected area shrinks as K grows", 0.0, "above",
          "rank correlation of K and area, its sign turned"),
    Claim("k50-fragments", _VARIATIONS, "at K = 50 objects fragment", 0.0, "above",
          "components that are mostly the object's, less those at K = 25"),
    Claim("k25-best", _VARIATIONS, "K = 25 is the best balance", 0.0, "above",
          "F1 on points at K = 25, less that of the best other K"),
    Claim("pca-keeps", _VARIATIONS, "PCA keeps the detections", _SIMILAR, "similar",
          "F1 on points with PCA, less without"),
    Claim("pca-saves", _VARIATIONS, "PCA saves 10 % of the total time", 0.1, "percent", "share of the time saved"),
    Claim("edges", "Limitations", "false positives sit at scene edges", 0.0, "above",
          "share of false points at the edge, less that of all unchanged points"),
    Claim("tradeoff", _FUTURE, "run time against accuracy", None, "open",
          "F1 on points at K = 50, less K = 10"),
    Claim("downsampling", _FUTURE, "the effect of downsampling", None, "open",
          "F1 on points with the coarsest voxels, less the finest"),
    Claim("filtering", _FUTURE, "the effect of filtering", None, "open",
          "F1 on points with outlier removal, less without"),
    Claim("mixed", _FUTURE, "appearances and disappearances in one scene", None, "open",
          "F1 on points, mean of both directions"),
    Claim("merging", _VARIATIONS, "fragments with near centres are one change", None, "open",
          "F1 at K = 50, fragments merged, less not merged"),
)  # fmt: skip
"""Every claim of the paper that a number can speak to."""
