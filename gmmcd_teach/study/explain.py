"""Experiments that change one thing at a time, to tell what our numbers owe to it (appendix C)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.detection import Detection, prepare
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.emd import emd, mean_distances
from gmmcd_teach.extraction import extract_changes
from gmmcd_teach.lab.pair import ScenePair
from gmmcd_teach.metrics import changed_share, component_truth
from gmmcd_teach.mixture import GaussianMixture
from gmmcd_teach.study.scans import scan
from gmmcd_teach.study.scores import Row
from gmmcd_teach.study.sweep import at_edge, scored_rows

CHANGES = ("as it is", "no shadows", "no lost wall", "no new wall", "no edges", "one start", "one scan", "one fit")
"""What can be changed: surface that one scan could not see is left out; of this only what the later scan lost, or only
what it alone has; the edges of both scans are left out; EM on the later cloud starts from the earlier mixture; what has
stayed is not scanned twice, but fitted twice; it is neither scanned nor fitted twice."""


def explained_runs(
    scene: str, seed: int, change: str = "as it is", leaf_size: float | None = None, max_components: int = 25
) -> list[Row]:
    """The rows of `sweep_runs`, with one thing changed, and what `balance` gives.

    Parameters
    ----------
    scene, seed : see `simulate_pair`; the seed starts EM, too.
    change : one of `CHANGES`.
    leaf_size, max_components : see `detect_changes`.

    Raises
    ------
    ValueError
        An unknown change; the message names those allowed.

    Examples
    --------
    >>> [row["level"] for row in explained_runs("cargo_bag", 1, "no shadows", leaf_size=0.1, max_components=5)][:2]
    ['component', 'point']
    """
    if change not in CHANGES:
        raise ValueError(f"change = {change!r}; expected one of {', '.join(map(repr, CHANGES))}")
    pair = scan(scene, seed, frames=False)
    keep = [np.ones(len(cloud), dtype=bool) for cloud in (pair.before, pair.after)]
    if change in ("no shadows", "no lost wall"):
        keep[0] = ~pair.hidden_before
    if change in ("no shadows", "no new wall"):
        keep[1] = ~pair.hidden_after
    if change == "no edges":
        keep = [~at_edge(cloud) for cloud in (pair.before, pair.after)]
    pair = stayed(pair) if change in ("one scan", "one fit") else only(pair, *keep)
    rng = np.random.default_rng([seed, 0])
    thin = [prepare(cloud, leaf_size, False) for cloud in (pair.before, pair.after)]
    old = fit_mixture(thin[0], max_components, rng=rng).mixture
    if change == "one start":
        new = fit_mixture(thin[1], old.n_components, init=old).mixture
    elif change == "one fit":
        things = prepare(pair.after[pair.appeared], leaf_size, False)
        most = min(4 * len(pair.object_names), len(things))
        new = joined(old, len(thin[0]), fit_mixture(things, most, rng=rng).mixture, len(things))
    else:
        new = fit_mixture(thin[1], max_components, rng=rng).mixture
    taken = extract_changes(old, new).indices
    claimed = np.isin(new.assign(pair.after), taken)
    detection = Detection(claimed, np.zeros(len(pair.before), dtype=bool), old, new, taken)
    return scored_rows(detection, pair, (pair.before, pair.after), **balance(old, new, pair))


def balance(old: GaussianMixture, new: GaussianMixture, pair: ScenePair) -> Row:
    """Where the mass of what is new comes from, and what the greedy step would gain by its removal.

    Returns
    -------
    `from_lost` : of the mass that flows to truly new components, the share out of wall that the later scan has lost.
    `gain_true` : metres by which the EMD falls when all truly new components are removed; below 0 it rises.
    Both are NaN where no component, or every one, is mostly new.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> one = GaussianMixture([1.0], [[0.0, 0.0, 0.0]], [np.eye(3)])
    >>> balance(one, one, pair)
    {'from_lost': nan, 'gain_true': nan}
    """
    is_new = component_truth(new, pair.after, pair.appeared)  # (L,)
    if is_new.all() or not is_new.any():
        return {"from_lost": float("nan"), "gain_true": float("nan")}
    lost = changed_share(old.assign(pair.before), pair.hidden_before, old.n_components)  # (K,)
    cost, stay = mean_distances(old, new), np.flatnonzero(~is_new)
    now = emd(old.weights, new.weights, cost)
    without = emd(old.weights, new.subset(stay).weights, cost[:, stay])
    arriving = now.flow[:, is_new].sum(axis=1)  # (K,)
    return {"from_lost": float(lost @ arriving / arriving.sum()), "gain_true": now.distance - without.distance}


def only(pair: ScenePair, before: NDArray[np.bool_], after: NDArray[np.bool_]) -> ScenePair:
    """The pair with some of its points: bool (N_before,) and (N_after,).

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> bool(only(pair, pair.before[:, 2] < 0.5, pair.appeared).appeared.all())
    True
    """
    return replace(
        pair,
        before=pair.before[before],
        before_objects=pair.before_objects[before],
        hidden_before=pair.hidden_before[before],
        after=pair.after[after],
        after_objects=pair.after_objects[after],
        hidden_after=pair.hidden_after[after],
    )


def stayed(pair: ScenePair) -> ScenePair:
    """The pair as if all else had stayed to the point: the later cloud is the earlier one and what has appeared.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> len(stayed(pair).after) == len(pair.before) + int(pair.appeared.sum())
    True
    """
    new, n = pair.appeared, len(pair.before)
    return replace(
        pair,
        after=np.concatenate([pair.before, pair.after[new]]),
        after_objects=np.concatenate([np.zeros(n, dtype=pair.after_objects.dtype), pair.after_objects[new]]),
        hidden_before=np.zeros(n, dtype=bool),
        hidden_after=np.zeros(n + int(new.sum()), dtype=bool),
    )


def joined(p: GaussianMixture, n_p: int, q: GaussianMixture, n_q: int) -> GaussianMixture:
    """One mixture of two clouds' mixtures, of n_p and n_q points.

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[0.0]], [[[1.0]]])
    >>> joined(one, 3, one, 1).weights
    array([0.75, 0.25])
    """
    share = n_q / (n_p + n_q)
    return GaussianMixture(
        np.concatenate([(1 - share) * p.weights, share * q.weights]),
        np.concatenate([p.means, q.means]),
        np.concatenate([p.covariances, q.covariances]),
    )
