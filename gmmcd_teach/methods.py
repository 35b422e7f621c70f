"""detect_changes: the top floor, one table from a method's name to its function (chapters 9 and 18)."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.beyond.baselines import detect_c2c, detect_m3c2, detect_occupancy
from gmmcd_teach.beyond.recommended import detect_recommended
from gmmcd_teach.beyond.shared import detect_shared
from gmmcd_teach.beyond.visibility import check_origin
from gmmcd_teach.clouds import CloudError, check_points
from gmmcd_teach.detection import Detection, detect_greedy
from gmmcd_teach.em import fit_mixture

METHODS: dict[str, Callable[..., Detection]] = {
    "greedy": detect_greedy,
    "shared": detect_shared,
    "recommended": detect_recommended,
    "c2c": detect_c2c,
    "m3c2": detect_m3c2,
    "occupancy": detect_occupancy,
}


def detect_changes(
    before: ArrayLike,
    after: ArrayLike,
    *,
    method: str = "greedy",
    max_components: int = 25,
    leaf_size: float | None = None,
    outlier_filter: bool = False,
    n_principal_axes: int | None = None,
    before_origin: ArrayLike | None = None,
    after_origin: ArrayLike | None = None,
    rng: int | np.random.Generator = 0,
    progress: bool = False,
    **options: Any,
) -> Detection:
    """Find what appeared and what disappeared between two scans of one place.

    Parameters
    ----------
    before, after : (N, D) metres, in one coordinate frame.
    method : a key of `METHODS`; "greedy" is the paper's.
    max_components : K at the start of EM. For methods that fit mixtures: "greedy" and "shared"; others leave it out.
    leaf_size : metres, edge of the voxel grid that thins the clouds first, or of the cells that the method works on;
        None leaves that to the method. "c2c" works on all points.
    outlier_filter : take out statistical outliers first, for "greedy" and "shared".
    n_principal_axes : project the clouds on this many principal axes first, for "greedy"; None does not.
    before_origin, after_origin : (D,) metres, where the sensor stood, for methods that ask what it could see.
    rng : seed or generator; the same seed gives the same answer.
    progress : show how far the work has come.
    **options : what the method takes besides.

    Raises
    ------
    CloudError
        A cloud or an origin cannot be used, or the clouds differ in dimension.
    ValueError
        An unknown method, or an option that the method does not take; the message names those allowed.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> room = rng.uniform(0, 1, (500, 3))
    >>> detection = detect_changes(room, np.concatenate([room, rng.normal(3, 0.1, (80, 3))]), max_components=4)
    >>> bool(detection.appeared[500:].all())
    True
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r}; expected one of {', '.join(map(repr, METHODS))}")
    old, new = check_points(before, "before"), check_points(after, "after")
    if old.shape[1] != new.shape[1]:
        raise CloudError(f"before, after: {old.shape[1]} and {new.shape[1]} dimensions; expected the same")
    common = {
        "max_components": max_components,
        "leaf_size": leaf_size,
        "outlier_filter": outlier_filter,
        "n_principal_axes": n_principal_axes,
        "before_origin": check_origin(before_origin, "before_origin", old.shape[1]),
        "after_origin": check_origin(after_origin, "after_origin", old.shape[1]),
        "rng": rng,
        "progress": progress,
    }
    function = METHODS[method]
    takes = options_of(function)
    unknown = sorted(set(options) - takes)
    if unknown:
        extra = ", ".join(sorted(takes - set(common))) or "none"
        raise ValueError(f"method {method!r} takes no option {unknown[0]!r}; options of its own: {extra}")
    return function(old, new, **{name: value for name, value in common.items() if name in takes}, **options)


def options_of(function: Callable[..., Detection]) -> set[str]:
    """Names of the keyword arguments of a method, those that it hands on to `fit_mixture` included.

    Examples
    --------
    >>> "covariance_floor" in options_of(detect_greedy)
    True
    """
    parameters = signature(function).parameters.values()
    names = {p.name for p in parameters if p.kind is Parameter.KEYWORD_ONLY}
    if any(p.kind is Parameter.VAR_KEYWORD for p in parameters):
        names |= {p.name for p in signature(fit_mixture).parameters.values() if p.kind is Parameter.KEYWORD_ONLY}
    return names - {"on_record", "point_weights"}  # one array cannot weigh the points of two clouds
