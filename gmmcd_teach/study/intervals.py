"""Means over seeds, and how far they can be trusted (chapter 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

KINDS = ("t", "bootstrap")
RESAMPLES = 4000


@dataclass(frozen=True)
class Interval:
    """A mean, the ends of its confidence interval, and the number of values behind it.

    Examples
    --------
    >>> print(Interval(0.5, 0.25, 0.75, 10))
    0.50 [0.25, 0.75]
    """

    mean: float
    low: float
    high: float
    n: int

    def __str__(self) -> str:
        mean, low, high = (round(x, 2) + 0.0 for x in (self.mean, self.low, self.high))  # no -0.00
        return f"{mean:.2f} [{low:.2f}, {high:.2f}]"


def mean_interval(
    values: ArrayLike,
    *,
    kind: str = "t",
    level: float = 0.95,
    within: tuple[float, float] = (-np.inf, np.inf),
    rng: int | np.random.Generator = 0,
) -> Interval:
    """Mean and confidence interval of independent values; NaN, a question that was not asked, is left out.

    Parameters
    ----------
    values : (n,) one number for each run; runs on one scan are not independent: average them first, see `scan_means`.
    kind : "t", Student's interval, mean +- t s / sqrt(n), honest for few runs; "bootstrap", the percentiles of the
        means of resamples (Efron 1979), too narrow below some ten runs.
    level : coverage, between 0 and 1.
    within : the range that the mean cannot leave, (0, 1) for a score; the interval is cut there.
    rng : seed or generator of the resamples.

    Returns
    -------
    One value alone has an interval as wide as `within`; none at all has the mean NaN.

    Raises
    ------
    ValueError
        An unknown kind, or a level outside 0 to 1.

    Examples
    --------
    >>> print(mean_interval([1.0, 2.0, 3.0]))
    2.00 [-0.48, 4.48]
    """
    if kind not in KINDS:
        raise ValueError(f"kind = {kind!r}; expected one of {', '.join(map(repr, KINDS))}")
    if not 0 < level < 1:
        raise ValueError(f"level = {level}; expected more than 0 and less than 1")
    x = np.asarray(values, dtype=np.float64).ravel()
    x = x[~np.isnan(x)]
    n, mean = len(x), float(x.mean()) if len(x) else float("nan")
    if n < 2:
        return Interval(mean, float(within[0]), float(within[1]), n)
    if kind == "t":
        half = float(stats.t.ppf((1 + level) / 2, n - 1) * x.std(ddof=1) / np.sqrt(n))
        low, high = mean - half, mean + half
    else:
        means = np.random.default_rng(rng).choice(x, (RESAMPLES, n)).mean(axis=1)
        low, high = map(float, np.quantile(means, [(1 - level) / 2, (1 + level) / 2]))
    return Interval(mean, max(low, float(within[0])), min(high, float(within[1])), n)


def share_interval(happened: ArrayLike, *, level: float = 0.95) -> Interval:
    """Share of independent values in which something happened, with the interval of Clopper and Pearson (1934).

    Student's interval has no width where all values agree. This one asks which true shares could have given so many
    cases, and keeps a width that depends on their number; it covers at least as often as it says.

    Parameters
    ----------
    happened : (n,) False or True, or a share between them where a value is itself a mean of several tries.
    level : coverage, between 0 and 1.

    Returns
    -------
    No value at all has the mean NaN.

    Examples
    --------
    >>> print(share_interval([False] * 10))
    0.00 [0.00, 0.31]
    """
    x = np.asarray(happened, dtype=np.float64).ravel()
    n, cases, tail = len(x), float(x.sum()), (1 - level) / 2
    if n == 0:
        return Interval(float("nan"), 0.0, 1.0, 0)
    low = float(stats.beta.ppf(tail, cases, n - cases + 1)) if cases > 0 else 0.0
    high = float(stats.beta.ppf(1 - tail, cases + 1, n - cases)) if cases < n else 1.0
    return Interval(cases / n, low, high, n)


def summary(table: pd.DataFrame, by: Sequence[str], columns: Sequence[str], **options: Any) -> pd.DataFrame:
    """Mean and interval of some columns in each group of rows, as a tidy table.

    Parameters
    ----------
    table : one row for each run.
    by : columns that name the group.
    columns : what to average.
    **options : see `mean_interval`.

    Returns
    -------
    One row for each group and column: `by`, "metric", "mean", "low", "high", "n".

    Examples
    --------
    >>> runs = pd.DataFrame({"scene": ["a", "a", "b"], "f1": [0.0, 1.0, 0.5]})
    >>> summary(runs, ["scene"], ["f1"], within=(0, 1))[["scene", "mean", "n"]].values.tolist()
    [['a', 0.5, 2], ['b', 0.5, 1]]
    """
    rows = []
    for names, group in table.groupby(list(by), sort=False):
        for column in columns:
            interval = mean_interval(group[column], **options)
            rows.append({**dict(zip(by, names, strict=True)), "metric": column, **vars(interval)})
    return pd.DataFrame(rows)
