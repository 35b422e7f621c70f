"""The ledger: each claim of the paper beside what the study's tables say, judged by its rule (appendix C)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from gmmcd_teach.study.claims import CLAIMS, Claim, too_few, verdict
from gmmcd_teach.study.grids import LEAVES, SIZES
from gmmcd_teach.study.intervals import Interval, mean_interval, share_interval
from gmmcd_teach.study.reasons import reason
from gmmcd_teach.study.runtime import PUBLISHED_RUNTIME, growth
from gmmcd_teach.study.tables import FORWARD, PUBLISHED_METRICS, Tables, appeared, at, scan_means

Measure = Callable[[Tables], Interval]
SHARE = (0.0, 1.0)
WORDS = {
    "percent": "10 %",
    "range": "20 to 23",
    "linear": "says so",
    "similar": "says so",
    "most": "in every case",
    "above": "says so",
    "open": "no value",
}
"""What the paper says, for rules whose claims have no number of their own."""


def ledger(tables: Tables) -> pd.DataFrame:
    """One row for each claim of `CLAIMS`, in their order.

    Parameters
    ----------
    tables : name -> table, for every name in `GRIDS`, see `measured`.

    Returns
    -------
    `claim`, `where`, `says`, `paper` (text), `measured` (what our number is), `mean`, `low`, `high`, `n`, `unit` (what
    n counts), `rule`, `verdict`, `few` (are there too few scans for the rule?), `why` (one sentence).

    Raises
    ------
    ValueError
        A claim without a measurement.

    Examples
    --------
    >>> set(MEASURES) == {claim.name for claim in CLAIMS}
    True
    """
    rows = []
    for claim in CLAIMS:
        if claim.name not in MEASURES:
            raise ValueError(f"claim {claim.name!r} has no measurement")
        ours = MEASURES[claim.name](tables)
        rows.append(
            {
                "claim": claim.name,
                "where": claim.where,
                "says": claim.says,
                "paper": printed(claim),
                "measured": claim.measured,
                **vars(ours),
                "unit": claim.unit,
                "rule": claim.rule,
                "verdict": verdict(claim, ours),
                "few": too_few(claim, ours),
                "why": reason(claim, ours, tables),
            }
        )
    return pd.DataFrame(rows)


def printed(claim: Claim) -> str:
    """What the paper says, as text: its number where the claim has one.

    Examples
    --------
    >>> printed(CLAIMS[0])
    '0.044'
    """
    if claim.rule in ("value", "seconds"):
        return f"{claim.value:.3f}"
    return WORDS[claim.rule]


def welch(a: ArrayLike, b: ArrayLike, level: float = 0.95) -> Interval:
    """Difference of the means of two independent groups, with Welch's interval; NaN is left out.

    Returns
    -------
    `n` is the size of the smaller group. One value has no spread: with a group of one the interval is the whole line.

    Examples
    --------
    >>> print(welch([1.0, 2.0, 3.0], [0.0, 1.0, 2.0]))
    1.00 [-1.27, 3.27]
    """
    x, y = (v[~np.isnan(v)] for v in (np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)))
    mean, n = float(x.mean() - y.mean()), min(len(x), len(y))
    if n < 2:
        return Interval(mean, -np.inf, np.inf, n)
    p, q = (v.var(ddof=1) / len(v) for v in (x, y))
    if p + q == 0:
        return Interval(mean, mean, mean, n)
    freedom = (p + q) ** 2 / (p**2 / (len(x) - 1) + q**2 / (len(y) - 1))
    half = float(stats.t.ppf((1 + level) / 2, freedom) * np.sqrt(p + q))
    return Interval(mean, mean - half, mean + half, n)


def _best(metric: str, winner: str) -> Measure:
    def measure(tables: Tables) -> Interval:
        groups = {objects: appeared(tables, metric, objects) for objects in PUBLISHED_METRICS.columns}
        rival = max((name for name in groups if name != winner), key=lambda name: groups[name].mean())
        return welch(groups[winner], groups[rival])

    return measure


def _paired(new: pd.DataFrame, old: pd.DataFrame, column: str = "f1") -> pd.Series[float]:
    keys = ["scene", "seed"]
    return new.set_index(keys)[column] - old.set_index(keys)[column]


def _disappearances(tables: Tables) -> Interval:
    keys, rows = ["scene", "seed", "start"], tables["metrics"]
    forward = at(rows, "component", order="forward", direction="appeared").set_index(keys)["f1"]
    backward = at(rows, "component", order="backward", direction="disappeared").set_index(keys)["f1"]
    return mean_interval((forward - backward).groupby(["scene", "seed"]).mean().dropna())


def _area(tables: Tables) -> Interval:
    ranks = [
        stats.spearmanr(run["max_components"], run["claimed"])[0] for _, run in at(tables["sweep"]).groupby("seed")
    ]
    return mean_interval(-np.array(ranks), within=(-1, 1))


def _balance(tables: Tables) -> Interval:
    rows = at(tables["sweep"])
    others = rows[rows["max_components"] != 25].groupby("max_components")["f1"].mean()
    return mean_interval(_paired(at(rows, max_components=25), at(rows, max_components=others.idxmax())))


def _saved(tables: Tables) -> Interval:
    old, new = (at(tables[name]).set_index(["scene", "seed"])["cpu"] for name in ("frames", "plane"))
    return mean_interval(1 - new / old)


def _stars(tables: Tables) -> Interval:
    rows = at(tables["frames"])
    return mean_interval((rows["n_before"] + rows["n_after"]) / 2)


def _mixed(tables: Tables) -> Interval:
    rows = at(tables["mixed"], order="forward")
    return mean_interval(rows.groupby("seed")["f1"].mean(), within=SHARE)


def _seconds(k: int, step: str) -> Measure:
    return lambda tables: mean_interval(tables["times"].set_index("max_components").loc[[k], step], within=(0, np.inf))


def _metric(metric: str, objects: str) -> Measure:
    return lambda tables: mean_interval(appeared(tables, metric, objects), within=SHARE)


def _share(table: str, holds: Callable[[pd.DataFrame], ArrayLike], level: str = "point", **where: object) -> Measure:
    def measure(tables: Tables) -> Interval:
        rows = at(tables[table], level, **where)
        happened = rows.assign(happened=np.asarray(holds(rows), dtype=float))
        return share_interval(scan_means(happened, [], ["happened"])["happened"])

    return measure


MEASURES: dict[str, Measure] = {
    **{f"time-{k}-{step}": _seconds(k, step) for k in PUBLISHED_RUNTIME.index for step in PUBLISHED_RUNTIME.columns},
    "em-dominates": lambda tables: mean_interval(tables["times"]["em"] / tables["times"]["total"], within=SHARE),
    "linear-in-k": lambda tables: growth(tables["times"]["max_components"], tables["times"]["em"]),
    **{f"{m}-{objects}": _metric(m, objects) for objects in PUBLISHED_METRICS.columns for m in PUBLISHED_METRICS.index},
    "recall-best-one": _best("recall", "one"),
    "precision-best-three": _best("precision", "three"),
    "f1-best-three": _best("f1", "three"),
    "f1-one-over-two": lambda tables: welch(appeared(tables, "f1", "one"), appeared(tables, "f1", "two")),
    "disappearances-similar": _disappearances,
    "k-star": _stars,
    "frame-found": _share("frames", lambda rows: rows["missed"] == ""),
    "frame-clean": _share("frames", lambda rows: rows["fp"] == 0, level="object"),
    "map-two-found": _share("metrics", lambda rows: rows["missed"] == "", scene="two_objects", **FORWARD),
    "map-three-found": _share(
        "metrics",
        lambda rows: rows["found"].str.contains("crate") & rows["found"].str.contains("cargo bag"),
        scene="three_objects",
        **FORWARD,
    ),
    "docked-missed": _share(
        "metrics", lambda rows: rows["missed"].str.contains("astrobee"), scene="three_objects", **FORWARD
    ),
    "k10-missed": _share("sweep", lambda rows: rows["missed"] != "", max_components=SIZES[0]),
    "area-shrinks": _area,
    "k50-fragments": lambda tables: mean_interval(
        _paired(at(tables["sweep"], max_components=SIZES[-1]), at(tables["sweep"], max_components=25), column="n_true")
    ),
    "k25-best": _balance,
    "pca-keeps": lambda tables: mean_interval(_paired(at(tables["plane"]), at(tables["frames"]))),
    "pca-saves": _saved,
    "edges": lambda tables: mean_interval(at(tables["frames"])["edge_false"] - at(tables["frames"])["edge_all"]),
    "tradeoff": lambda tables: mean_interval(
        _paired(at(tables["sweep"], max_components=SIZES[-1]), at(tables["sweep"], max_components=SIZES[0]))
    ),
    "downsampling": lambda tables: mean_interval(
        _paired(at(tables["leaves"], leaf_size=LEAVES[-1]), at(tables["leaves"], leaf_size=LEAVES[0]))
    ),
    "filtering": lambda tables: mean_interval(_paired(at(tables["cleaned"]), at(tables["frames"]))),
    "mixed": _mixed,
    "merging": lambda tables: mean_interval(
        _paired(
            at(tables["sweep"], "merged", max_components=SIZES[-1]),
            at(tables["sweep"], "component", max_components=SIZES[-1]),
        )
    ),
}
"""Name of each claim -> what our number is, from the tables."""
