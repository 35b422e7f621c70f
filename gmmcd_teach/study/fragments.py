"""Fragments of one thing counted as one: components whose centres are close (chapter 11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from gmmcd_teach.clouds import Floats
from gmmcd_teach.metrics import Confusion, changed_share

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


def merged_confusion(means: Floats, taken: ArrayLike, owner: Indices, changed: ArrayLike, reach: float) -> Confusion:
    """Count groups of components in place of components.

    A group of components taken is a tp where more than half of its points have changed, else an fp. A group of changed
    components of which none was taken is an fn; components in neither kind of group are tn.

    Parameters
    ----------
    means : (K, D) metres, of all components.
    taken : indices of the components that were extracted.
    owner : (N,) int, the component of each point, see `GaussianMixture.assign`.
    changed : (N,) bool, the truth.
    reach : see `merge_fragments`.

    Raises
    ------
    ValueError
        `reach` is negative.

    Examples
    --------
    >>> merged_confusion(np.array([[0.0], [8.9], [9.1]]), [1, 2], np.arange(3), [False, True, True], reach=0.5)
    Confusion(tp=1, fp=0, fn=0, tn=1)
    """
    flags = np.asarray(changed)
    truth = changed_share(owner, flags, len(means)) > 0.5  # (K,)
    is_taken = np.isin(np.arange(len(means)), np.asarray(taken, dtype=np.intp))
    claims = merge_fragments(means, np.flatnonzero(is_taken), reach)
    mine = [np.isin(owner, group) for group in claims]  # (N,) for each claim
    tp = sum(bool(m.any() and flags[m].mean() > 0.5) for m in mine)
    real = merge_fragments(means, np.flatnonzero(truth), reach)
    fn = sum(not is_taken[group].any() for group in real)
    return Confusion(tp, len(claims) - tp, fn, int(np.count_nonzero(~truth & ~is_taken)))
