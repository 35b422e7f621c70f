"""Counting right and wrong: the confusion table and its scores (chapter 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import CloudError, Floats
from gmmcd_teach.mixture import GaussianMixture


@dataclass(frozen=True)
class Confusion:
    """How often a yes/no answer was right: true and false positives, false and true negatives.

    A score whose denominator is 0 is NaN: the question was not asked. One exception: with nothing to find and
    nothing claimed, F1 is 1.

    Examples
    --------
    >>> Confusion(tp=3, fp=1, fn=0, tn=6).precision
    0.75
    """

    tp: int
    fp: int
    fn: int
    tn: int

    @property
    def accuracy(self) -> float:
        """Share of all answers that were right (Eq. 20)."""
        return _ratio(self.tp + self.tn, self.tp + self.fn + self.tn + self.fp)

    @property
    def precision(self) -> float:
        """Share of the claimed changes that were real (Eq. 21)."""
        return _ratio(self.tp, self.tp + self.fp)

    @property
    def recall(self) -> float:
        """Share of the real changes that were claimed (Eq. 22)."""
        return _ratio(self.tp, self.tp + self.fn)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall (Eq. 23)."""
        return _ratio(2 * self.tp, 2 * self.tp + self.fp + self.fn, empty=1.0)


def _ratio(part: int, whole: int, empty: float = float("nan")) -> float:
    return part / whole if whole else empty


def confusion(predicted: ArrayLike, actual: ArrayLike) -> Confusion:
    """Compare two boolean arrays of shape (N,): what was predicted and what is the actual truth.

    Raises
    ------
    CloudError
        The arrays are not boolean, not one-dimensional or not of one length.

    Examples
    --------
    >>> confusion([True, True, False], [True, False, False])
    Confusion(tp=1, fp=1, fn=0, tn=1)
    """
    p, a = _flags(predicted, "predicted"), _flags(actual, "actual")
    if p.shape != a.shape:
        raise CloudError(f"predicted, actual: {len(p)} and {len(a)} answers; expected as many of one as of the other")
    return Confusion(*(int(np.count_nonzero(x)) for x in (p & a, p & ~a, ~p & a, ~p & ~a)))


def component_truth(
    mixture: GaussianMixture, points: ArrayLike, changed: ArrayLike, threshold: float = 0.5
) -> NDArray[np.bool_]:
    """(K,) bool: is more than `threshold` of the points that a component explains really changed?

    A point belongs to the component of largest posterior, weights included. A component that wins no point
    is not changed.

    Parameters
    ----------
    mixture : the mixture fitted to `points`.
    points : (N, D) metres.
    changed : (N,) bool, the truth for each point.
    threshold : share of changed points above which the component counts as changed, 0 to 1.

    Raises
    ------
    CloudError
        `changed` is not one flag per point.
    ValueError
        `threshold` is outside 0 to 1.

    Examples
    --------
    >>> pair = GaussianMixture([0.5, 0.5], [[0.0], [9.0]], [[[1.0]], [[1.0]]])
    >>> component_truth(pair, [[0.1], [8.8], [9.1]], [False, True, True])
    array([False,  True])
    """
    flags = _flags(changed, "changed")
    if not 0 <= threshold <= 1:
        raise ValueError(f"threshold = {threshold}; expected 0 to 1")
    owner = mixture.assign(points)
    if len(owner) != len(flags):
        raise CloudError(f"changed: {len(flags)} flags for {len(owner)} points; expected one each")
    return changed_share(owner, flags, mixture.n_components) > threshold


def changed_share(owner: NDArray[np.intp], changed: ArrayLike, n_components: int) -> Floats:
    """(K,) share of each component's points that have changed, 0 for a component without points.

    Parameters
    ----------
    owner : (N,) int, the component of each point, see `GaussianMixture.assign`.
    changed : (N,) bool, the truth for each point.
    n_components : K.

    Examples
    --------
    >>> changed_share(np.array([0, 0, 2]), [True, False, True], 3)
    array([0.5, 0. , 1. ])
    """
    total = np.bincount(owner, minlength=n_components)  # (K,)
    hits = np.bincount(owner[np.asarray(changed)], minlength=n_components)
    return np.asarray(hits / np.maximum(total, 1))


def _flags(array: ArrayLike, name: str) -> NDArray[np.bool_]:
    flags = np.asarray(array)
    if flags.ndim != 1 or flags.dtype != bool:
        raise CloudError(f"{name}: {flags.dtype} of shape {flags.shape}; expected bool of shape (N,)")
    return flags
