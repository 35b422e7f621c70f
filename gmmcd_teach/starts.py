"""What EM needs before its first step: settings and weights in order, and a mixture to start from (chapter 5)."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.clouds import CloudError, Floats
from gmmcd_teach.mixture import GaussianMixture, floats

UPDATES = ("batch", "componentwise")
INITS = ("random", "kmeans++")


def starting_mixture(
    points: Floats, counts: Floats, n_components: int, init: str, covariance_floor: float, rng: np.random.Generator
) -> GaussianMixture:
    """K equal round Gaussians on points drawn at random, a tenth of the largest variance each (published code).

    "kmeans++" draws each next mean with a probability that grows with the squared distance to those drawn before
    (Arthur & Vassilvitskii 2007).

    Raises
    ------
    ValueError
        More components than points, none, or an unknown `init`; the message names those allowed.

    Examples
    --------
    >>> line = np.arange(10.0)[:, None]
    >>> start = starting_mixture(line, np.ones(10), 3, "random", 0.0, np.random.default_rng(0))
    >>> start.weights.round(3), start.covariances.round(3)[0]
    (array([0.333, 0.333, 0.333]), array([[0.825]]))
    """
    n, d = points.shape
    if not 1 <= n_components <= n:
        raise ValueError(f"n_components = {n_components}; expected 1 to {n}, the number of points")
    if init not in INITS:
        raise ValueError(f"init = {init!r}; expected one of {', '.join(map(repr, INITS))}")
    share = counts / counts.sum()
    if init == "random":
        chosen = rng.choice(n, size=n_components, replace=False, p=share)
    else:
        nearest = np.ones(n)  # squared distance to the nearest mean drawn so far
        chosen = np.empty(n_components, dtype=np.intp)
        for k in range(n_components):
            chance = share * nearest if (share * nearest).sum() > 0 else share  # all points taken: identical ones
            chosen[k] = rng.choice(n, p=chance / chance.sum())
            distance = ((points - points[chosen[k]]) ** 2).sum(axis=1)
            nearest = distance if k == 0 else np.minimum(nearest, distance)
    variance = (share @ (points - share @ points) ** 2).max() / 10 + covariance_floor
    return GaussianMixture(
        np.full(n_components, 1 / n_components),
        points[chosen],
        np.broadcast_to(variance * np.eye(d), (n_components, d, d)),
    )


def check_options(
    max_components: int,
    min_components: int,
    tol: float,
    max_iter: int,
    update: str,
    init: str | GaussianMixture,
    cell_size: float | None,
    covariance_floor: float,
) -> None:
    """Raise a ValueError that names the first option of `fit_mixture` out of range, and the range.

    Examples
    --------
    >>> check_options(5, 1, 1e-5, 100, "batch", "random", None, 0.0)
    """
    check_number("max_components", max_components, 1, whole=True)
    check_number("min_components", min_components, 1, whole=True)
    check_number("max_iter", max_iter, 1, whole=True)
    check_number("tol", tol, 0)
    check_number("covariance_floor", covariance_floor, 0)
    if min_components > max_components:
        raise ValueError(f"min_components = {min_components}; expected at most max_components = {max_components}")
    if isinstance(init, GaussianMixture):
        if init.n_components != max_components:
            raise ValueError(f"init: a mixture of {init.n_components} components; expected {max_components}")
        init = INITS[0]
    for name, chosen, allowed, more in (
        ("update", update, UPDATES, ""),
        ("init", init, INITS, ", or a GaussianMixture"),
    ):
        if not isinstance(chosen, str) or chosen not in allowed:
            raise ValueError(f"{name} = {chosen!r}; expected one of {', '.join(map(repr, allowed))}{more}")
    if cell_size is not None and not (isinstance(cell_size, Real) and 0 < cell_size < np.inf):
        raise ValueError(f"cell_size = {cell_size!r}; expected metres above 0, or None")


def check_number(name: str, value: Any, lowest: int, whole: bool = False) -> None:
    """Raise a ValueError that names the option where it is no finite (`whole`) number, or below `lowest`.

    Examples
    --------
    >>> check_number("max_iter", 100, 1, whole=True)
    """
    number = isinstance(value, Integral if whole else Real) and not isinstance(value, bool)
    if not number or not lowest <= value < np.inf:
        raise ValueError(f"{name} = {value!r}; expected a {'whole ' if whole else ''}number of at least {lowest}")


def is_above_zero(value: Any) -> bool:
    """Is it a finite number above 0?

    Examples
    --------
    >>> is_above_zero(0.02), is_above_zero(0), is_above_zero(True), is_above_zero("wide")
    (True, False, False, False)
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    return bool(number and 0 < value < np.inf)


def check_weights(weights: ArrayLike | None, n_points: int, n_components: int, name: str = "point_weights") -> Floats:
    """(N,) weights as float64, ones by default; a CloudError where they are not one finite weight >= 0 a point.

    Examples
    --------
    >>> check_weights(None, 3, 1)
    array([1., 1., 1.])
    """
    counts = np.ones(n_points) if weights is None else floats(weights, name)
    if counts.shape != (n_points,):
        raise CloudError(f"{name}: shape {counts.shape}; expected ({n_points},)")
    if not np.isfinite(counts).all() or counts.min() < 0:
        raise CloudError(f"{name}: from {counts.min():.3g} to {counts.max():.3g}; expected finite weights >= 0")
    above = np.count_nonzero(counts)
    if above < n_components:
        raise CloudError(
            f"{name}: {above} weights above zero; at least one for each of {n_components} components needed"
        )
    return counts
