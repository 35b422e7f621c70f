"""The paper's table of run times measured anew, how they grow, and what accuracy a second buys (chapter 11)."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from gmmcd_teach.clouds import CloudError, read_cloud, write_cloud
from gmmcd_teach.detection import prepare
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.extraction import extract_changes
from gmmcd_teach.pca import principal_axes
from gmmcd_teach.study.intervals import Interval
from gmmcd_teach.study.scans import scan
from gmmcd_teach.study.scores import Row

STEPS = ("load", "pca", "em", "emd", "total")

PUBLISHED_RUNTIME = pd.DataFrame(
    [
        [0.044, 3.727, 2043.113, 0.677, 2047.561],
        [0.037, 2.580, 2804.327, 1.491, 2808.535],
        [0.037, 1.979, 4496.449, 3.070, 4501.535],
        [0.043, 2.920, 3307.551, 2.708, 3313.222],
        [0.023, 1.981, 5209.999, 5.254, 5217.257],
        [0.026, 2.169, 7714.528, 9.415, 7726.138],
    ],
    index=pd.Index([15, 20, 25, 30, 40, 50], name="K"),
    columns=list(STEPS),
)
"""The paper's table of run times, in seconds: two-object maps, not filtered, on an Apple M1."""


def runtime_runs(
    scene: str,
    seed: int,
    max_components: int = 25,
    leaf_size: float | None = None,
    n_principal_axes: int | None = 2,
    **em_options: Any,
) -> Row:
    """Time each step of the method on one pair of scans, as seconds of computing.

    Parameters
    ----------
    scene, seed : see `simulate_pair`; the seed starts EM, too.
    max_components, leaf_size, n_principal_axes : see `detect_changes`; thinning is part of no step, as in the paper.
    **em_options : see `fit_mixture`.

    Returns
    -------
    `load` (reading both clouds as .ply), `pca`, `em` (both fits), `emd` (extraction of what appeared), `total`, their
    sum; `n_points` of both clouds; `n_steps`, the M-steps of both fits; `updates`, the components updated in them,
    summed; `n_before` and `n_after`, K* of both fits.

    Examples
    --------
    >>> row = runtime_runs("cargo_bag", 1, 4, leaf_size=0.1)
    >>> sum(row[step] for step in ("load", "pca", "em", "emd")) == row["total"]
    True
    """
    pair, rng = scan(scene, seed, frames=False), np.random.default_rng([seed])
    seconds, last = dict.fromkeys(STEPS, 0.0), 0.0
    thin = [prepare(cloud, leaf_size, False) for cloud in (pair.before, pair.after)]

    def note(step: str) -> None:
        nonlocal last
        seconds[step], last = process_time() - last, process_time()

    with TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("before.ply", "after.ply")]
        for path, cloud in zip(paths, thin, strict=True):
            write_cloud(path, cloud)
        last = process_time()
        clouds = [read_cloud(path) for path in paths]
        note("load")
    if n_principal_axes is not None:
        axes = principal_axes(np.concatenate(clouds))
        clouds = [axes.project(cloud, n_principal_axes) for cloud in clouds]
        note("pca")
    fits = [fit_mixture(cloud, max_components, rng=rng, **em_options) for cloud in clouds]
    note("em")
    extract_changes(fits[0].mixture, fits[1].mixture)
    note("emd")
    seconds["total"] = sum(seconds[step] for step in STEPS[:-1])
    steps = [r.n_components for fit in fits for r in fit.history if r.event in ("step", "annihilated")]
    sizes = {"n_before": fits[0].mixture.n_components, "n_after": fits[1].mixture.n_components}
    return {**seconds, "n_points": sum(map(len, clouds)), "n_steps": len(steps), "updates": sum(steps), **sizes}


def growth(x: ArrayLike, y: ArrayLike, level: float = 0.95) -> Interval:
    """Exponent b of y = a x^b, least squares on the logarithms, with Student's interval; 1 is growth in proportion.

    Parameters
    ----------
    x, y : (n,) numbers above 0, n >= 3.
    level : coverage of the interval.

    Raises
    ------
    CloudError
        Fewer than three pairs, or a number that has no logarithm.

    Examples
    --------
    >>> round(growth([1, 2, 4, 8], [3, 12, 48, 192]).mean, 6)
    2.0
    """
    a, b = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1 or len(a) < 3 or not (np.all(a > 0) and np.all(b > 0)):
        raise CloudError(f"x, y: shapes {a.shape} and {b.shape}; expected at least three numbers above 0 in each")
    u, v = (np.log(values) - np.log(values).mean() for values in (a, b))
    slope = float(u @ v / (u @ u))
    left_over = v - slope * u
    error = np.sqrt(left_over @ left_over / (len(a) - 2) / (u @ u))
    half = float(stats.t.ppf((1 + level) / 2, len(a) - 2) * error)
    return Interval(slope, slope - half, slope + half, len(a))


def pareto_front(cost: ArrayLike, value: ArrayLike) -> NDArray[np.bool_]:
    """(n,) bool: choices that no other beats, by costing no more and being worth no less, one of the two strictly.

    Examples
    --------
    >>> pareto_front([1.0, 2.0, 3.0], [0.5, 0.4, 0.6])
    array([ True, False,  True])
    """
    c, v = np.asarray(cost, dtype=np.float64), np.asarray(value, dtype=np.float64)
    no_worse = (c[:, None] <= c) & (v[:, None] >= v)  # (n, n) is the row's choice no worse than the column's?
    better = (c[:, None] < c) | (v[:, None] > v)
    return np.asarray(~(no_worse & better).any(axis=0))
