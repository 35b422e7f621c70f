"""Every run that chapters 10 to 12 and the ledger stand on: asked for in the same words, so that each is made once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pandas as pd

from gmmcd_teach.study.explain import CHANGES, explained_runs
from gmmcd_teach.study.runs import arguments, run
from gmmcd_teach.study.runtime import PUBLISHED_RUNTIME, runtime_runs
from gmmcd_teach.study.scores import Row
from gmmcd_teach.study.sweep import sweep_runs
from gmmcd_teach.study.tables import metric_runs

SIZES = (10, 15, 20, 25, 30, 40, 50)
"""The paper's values of K."""

LEAF = 0.04
"""Metres: voxels of the single frames in chapters 11 and 12, so that ten seeds can be run for each setting."""

LEAVES = (0.03, LEAF, 0.06, 0.1)
"""Metres: voxels that are compared."""

_FRAMES: Row = {"scene": ("cargo_bag", "astrobee"), "seed": range(10)}
_MAPS: Row = {"scene": ("two_objects", "three_objects"), "seed": range(10), "leaf_size": (0.05,)}
_PLAIN: Row = {**_FRAMES, "max_components": (25,), "leaf_size": (LEAF,)}

GRIDS: dict[str, tuple[Callable[..., Any], list[Row]]] = {
    "metrics": (
        metric_runs,
        [
            *arguments({**_FRAMES, "leaf_size": (0.03,)}),
            *arguments(_MAPS),
        ],
    ),
    "sweep": (sweep_runs, arguments({**_PLAIN, "scene": ("cargo_bag",), "max_components": SIZES})),
    "times": (
        runtime_runs,
        [{"scene": "two_objects", "seed": 0, "max_components": k, "leaf_size": 0.02} for k in PUBLISHED_RUNTIME.index],
    ),
    "frames": (sweep_runs, arguments(_PLAIN)),
    "plane": (sweep_runs, arguments({**_PLAIN, "n_principal_axes": (2,)})),
    "leaves": (sweep_runs, arguments({**_PLAIN, "scene": ("cargo_bag",), "leaf_size": LEAVES})),
    "cleaned": (sweep_runs, arguments({**_PLAIN, "outlier_filter": (True,)})),
    "starts": (
        sweep_runs,
        arguments({"scene": ("cargo_bag",), "seed": range(3), "start": range(5), "leaf_size": (LEAF,)}),
    ),
    "mixed": (metric_runs, arguments({"scene": ("mixed_frame",), "seed": range(5), "leaf_size": (LEAF,)})),
    "explained": (
        explained_runs,
        [
            *arguments({**_FRAMES, "seed": range(5), "change": CHANGES, "leaf_size": (LEAF,)}),
            *arguments({**_MAPS, "seed": range(2), "change": CHANGES[:2] + CHANGES[-2:]}),
        ],
    ),
}
"""Name of a table -> the function that makes its rows, and the arguments of each call."""


def measured(name: str, **options: Any) -> pd.DataFrame:
    """The table of that name in `GRIDS`, run or read from what was kept.

    Parameters
    ----------
    name : a key of `GRIDS`.
    **options : see `run`.

    Raises
    ------
    ValueError
        No such table; the message lists them.

    Examples
    --------
    >>> measured("speed")
    Traceback (most recent call last):
    ValueError: no table 'speed'; expected one of 'metrics', 'sweep', 'times', 'frames', 'plane', 'leaves', ...
    """
    if name not in GRIDS:
        raise ValueError(f"no table {name!r}; expected one of {', '.join(map(repr, GRIDS))}")
    function, jobs = GRIDS[name]
    return run(function, jobs, **options)
