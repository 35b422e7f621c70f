"""Experiments that change one thing at a time, to tell what our numbers owe to it (appendix C)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.detection import Detection, prepare
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.extraction import extract_changes
from gmmcd_teach.lab.pair import ScenePair
from gmmcd_teach.mixture import GaussianMixture
from gmmcd_teach.study.scans import scan
from gmmcd_teach.study.scores import Row
from gmmcd_teach.study.sweep import at_edge, scored_rows

CHANGES = ("as it is", "no shadows", "no edges", "one start", "one fit")
"""What can be changed: surface that one scan could not see is left out; so are the edges of both scans; EM on the
later cloud starts from the earlier mixture; what has stayed is not scanned and fitted twice."""


def explained_runs(
    scene: str, seed: int, change: str = "as it is", leaf_size: float | None = None, max_components: int = 25
) -> list[Row]:
    """The rows of `sweep_runs`, with one thing changed.

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
    pair = scan(scene, seed)
    if change == "no shadows":
        pair = only(pair, ~pair.hidden_before, ~pair.hidden_after)
    if change == "no edges":
        pair = only(pair, ~at_edge(pair.before), ~at_edge(pair.after))
    if change == "one fit":
        pair = stayed(pair)
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
    return scored_rows(detection, pair, (pair.before, pair.after))


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
