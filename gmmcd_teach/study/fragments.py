"""Fragments of one thing counted as one: components whose centres are close (chapter 11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from gmmcd_teach.clouds import Floats
from gmmcd_teach.metrics import Confusion, component_truth
from gmmcd_teach.mixture import GaussianMixture

Indices = NDArray[np.intp]


def merge_fragments(means: Floats, taken: ArrayLike, reach: float) -> list[Indices]:
    """Groups of the components taken: two belong together when their centres, or a chain of centres, are within reach.

    The paper's suggestion for large K: "inferring distributions with centers close in space as a single scene change".

    Parameters
    ----------
    means : (K, D) metres, of all components.
    taken : (R,) indices of those that were extracted.
    reach : metres, 0 or more.

    Raises
    ------
    ValueError
        `reach` is negative.

    Examples
    --------
    >>> merge_fragments(np.array([[0.0], [0.2], [5.0], [9.0]]), [3, 0, 1], reach=0.3)
    [array([3]), array([0, 1])]
    """
    if not reach >= 0:
        raise ValueError(f"reach = {reach}; expected metres, 0 or more")
    indices = np.asarray(taken, dtype=np.intp)
    if not len(indices):
        return []
    near = cdist(means[indices], means[indices]) <= reach  # (R, R)
    number = connected_components(near, directed=False)[1]  # of each one taken
    return [indices[number == i] for i in range(number.max() + 1)]


def merged_confusion(
    mixture: GaussianMixture, taken: ArrayLike, points: ArrayLike, changed: ArrayLike, reach: float
) -> Confusion:
    """Count groups of components in place of components.

    A group of components taken is a tp where more than half of its points have changed, else an fp. A group of changed
    components of which none was taken is an fn; components in neither kind of group are tn.

    Parameters
    ----------
    mixture : the mixture fitted to `points`, K components.
    taken : indices of the components that were extracted.
    points : (N, D) metres.
    changed : (N,) bool, the truth.
    reach : see `merge_fragments`.

    Raises
    ------
    CloudError
        See `component_truth`.
    ValueError
        `reach` is negative.

    Examples
    --------
    >>> three = GaussianMixture([0.4, 0.3, 0.3], [[0.0], [8.9], [9.1]], [[[0.01]]] * 3)
    >>> merged_confusion(three, [1, 2], [[0.0], [8.9], [9.1]], [False, True, True], reach=0.5)
    Confusion(tp=1, fp=0, fn=0, tn=1)
    """
    truth = component_truth(mixture, points, changed)  # (K,)
    owner, flags = mixture.assign(points), np.asarray(changed)
    claims = merge_fragments(mixture.means, taken, reach)
    right = [bool(flags[np.isin(owner, group)].mean() > 0.5) if np.isin(owner, group).any() else False
             for group in claims]  # fmt: skip
    missed = [group for group in merge_fragments(mixture.means, np.flatnonzero(truth), reach)
              if not np.isin(group, np.asarray(taken)).any()]  # fmt: skip
    used = sum(map(len, claims)) + int((truth & ~np.isin(np.arange(len(truth)), np.asarray(taken))).sum())
    return Confusion(sum(right), len(right) - sum(right), len(missed), mixture.n_components - used)
