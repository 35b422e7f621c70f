"""Greedy extraction: take out the components whose removal brings the two mixtures closest (chapter 8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.emd import GROUNDS, MASSES, Transport, emd
from gmmcd_teach.mixture import GaussianMixture, check_mixture


@dataclass(frozen=True, eq=False)
class Extraction:
    """What was taken out of the later mixture: Pi of Algorithm 1.

    Attributes
    ----------
    indices : (R,) components of `after`, in the order taken.
    distances : (R + 1,) the EMD before the first removal and after each.
    """

    indices: NDArray[np.intp]
    distances: Floats


def extract_changes(
    before: GaussianMixture, after: GaussianMixture, *, ground: str = "means", mass: str = "normalized"
) -> Extraction:
    """Algorithm 1: while some removal lowers the EMD, remove the component that lowers it most.

    The published loop never tries the last component, and compares its second pass with the EMD before the first
    removal; here every component is tried, and each pass is compared with the one before. One component always stays.

    Parameters
    ----------
    before, after : mixtures of the same dimension.
    ground : "means" (the paper) or "bures", the distance between two components.
    mass : "normalized" re-normalises the remaining weights after each removal, "partial" does not (Eq. 18 taken
        literally: the removals then run away).

    Raises
    ------
    CloudError
        Not two mixtures of the same dimension.
    ValueError
        An unknown ground distance or mass; the message names those allowed.

    Examples
    --------
    >>> shelf = GaussianMixture([0.5, 0.5], [[0.0], [1.0]], [[[0.01]], [[0.01]]])
    >>> with_box = GaussianMixture([0.4, 0.4, 0.2], [[0.0], [1.0], [3.0]], [[[0.01]]] * 3)
    >>> extract_changes(shelf, with_box).indices
    array([2])
    """
    if not isinstance(ground, str) or ground not in GROUNDS:
        raise ValueError(f"ground = {ground!r}; expected one of {', '.join(map(repr, GROUNDS))}")
    if not isinstance(mass, str) or mass not in MASSES:
        raise ValueError(f"mass = {mass!r}; expected one of {', '.join(map(repr, MASSES))}")
    before, after = check_mixture(before, "before"), check_mixture(after, "after")
    cost = GROUNDS[ground](before, after)  # (K, L)
    here = emd(before.weights, after.weights, cost, mass=mass)
    left = np.arange(after.n_components)  # components not taken yet
    taken: list[int] = []
    distances = [here.distance]
    while np.count_nonzero(after.weights[left]) > 1:
        best, there = best_removal(before.weights, after.weights[left], cost[:, left], here, mass)
        if there.distance >= here.distance - 1e-12 * cost.max():
            break
        taken.append(int(left[best]))
        distances.append(there.distance)
        left, here = np.delete(left, best), there
    return Extraction(np.array(taken, dtype=np.intp), np.array(distances))


def best_removal(p: Floats, q: Floats, cost: Floats, here: Transport, mass: str) -> tuple[int, Transport]:
    """The removal that leaves the smallest EMD, and the transport after it.

    The prices of the present flow give a lower bound for each candidate (weak duality): the cheapest bounds are tried
    first, and a candidate whose bound is no better than the best EMD found need not be solved.
    """
    lowest = removal_bounds(q / q.sum(), here) if mass == "normalized" else np.full(len(q), -np.inf)  # (L,)
    best, there = -1, Transport(np.inf, here.flow, here.prices)
    for k in np.argsort(lowest, kind="stable"):
        if lowest[k] >= there.distance:
            break
        without_k = emd(p, np.delete(q, k), np.delete(cost, k, axis=1), mass=mass)
        if without_k.distance < there.distance:
            best, there = int(k), without_k
    return best, there


def removal_bounds(q: Floats, here: Transport) -> Floats:
    """(L,) for each component of the weights q (sum 1), a distance that the EMD after its removal cannot undercut.

    With prices v the EMD is u.p + v.q; after the removal of k the same u and v are still feasible, and q becomes
    (q - q_k e_k) / (1 - q_k).
    """
    income = here.prices @ q
    rest = np.maximum(1 - q, np.finfo(float).tiny)
    return here.distance - income + (income - here.prices * q) / rest
