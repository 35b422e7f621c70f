"""One detection scored on three levels: components, points and objects (chapter 10)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.detection import Detection
from gmmcd_teach.lab.pair import ScenePair
from gmmcd_teach.metrics import Confusion, component_truth, confusion
from gmmcd_teach.mixture import GaussianMixture
from gmmcd_teach.regions import find_regions

METRICS = ("accuracy", "precision", "recall", "f1")
Row = dict[str, Any]


def component_confusion(
    mixture: GaussianMixture, taken: ArrayLike, points: ArrayLike, changed: ArrayLike, threshold: float = 0.5
) -> Confusion:
    """Count components, as the paper does: those taken against those whose points have mostly changed.

    Parameters
    ----------
    mixture : the mixture fitted to `points`, K components.
    taken : indices of the components that were extracted.
    points : (N, D) metres.
    changed : (N,) bool, the truth.
    threshold : see `component_truth`.

    Raises
    ------
    CloudError
        `changed` is not one flag per point, or an index is not one of a component.
    ValueError
        `threshold` is outside 0 to 1.

    Examples
    --------
    >>> pair = GaussianMixture([0.5, 0.5], [[0.0], [9.0]], [[[1.0]], [[1.0]]])
    >>> component_confusion(pair, [1], [[0.1], [8.8], [9.1]], [False, True, True])
    Confusion(tp=1, fp=0, fn=0, tn=1)
    """
    indices = np.asarray(taken, dtype=np.intp)
    if indices.size and not (indices.min() >= 0 and indices.max() < mixture.n_components):
        raise CloudError(f"taken: {indices.min()} to {indices.max()}; expected 0 to {mixture.n_components - 1}")
    claimed = np.isin(np.arange(mixture.n_components), indices)  # (K,)
    return confusion(claimed, component_truth(mixture, points, changed, threshold))


def object_confusion(
    points: ArrayLike, claimed: ArrayLike, objects: ArrayLike, reach: float | None = None, smallest: int = 10
) -> Confusion:
    """Count objects: found, falsely claimed, missed.

    An object is found (tp) when more than half of its points are claimed, else missed (fn). A connected region of
    claimed points is a false object (fp) when at most half of its points have changed. Objects that are not there
    cannot be counted, so tn is 0, and "accuracy" is the share of tp in tp + fp + fn.

    Parameters
    ----------
    points : (N, D) metres.
    claimed : (N,) bool.
    objects : (N,) int, number of the changed object a point belongs to, 0 for none.
    reach, smallest : see `find_regions`.

    Raises
    ------
    CloudError
        The three do not have one entry per point.

    Examples
    --------
    >>> shelf = np.column_stack([np.arange(60) / 50, np.zeros(60)])
    >>> number = np.where(np.arange(60) < 20, 1, 0)
    >>> object_confusion(shelf, (number > 0) | (np.arange(60) > 40), number)
    Confusion(tp=1, fp=1, fn=0, tn=0)
    """
    s, flags, number = check_points(points, minimum=0), np.asarray(claimed), np.asarray(objects)
    if flags.shape != (len(s),) or flags.dtype != bool or number.shape != (len(s),) or number.dtype.kind not in "iu":
        raise CloudError(
            f"claimed, objects: {flags.dtype} of shape {flags.shape} and {number.dtype} of shape {number.shape}; "
            f"expected bool and int of shape ({len(s)},)"
        )
    found = [bool(flags[number == i].mean() > 0.5) for i in np.unique(number[number > 0])]
    regions = find_regions(s[flags], reach, smallest, contradicted=number[flags] > 0)
    false = sum(region.confidence is not None and region.confidence <= 0.5 for region in regions)
    return Confusion(tp=sum(found), fp=false, fn=len(found) - sum(found), tn=0)


def score(
    detection: Detection,
    pair: ScenePair,
    *,
    threshold: float = 0.5,
    overlap: float | None = None,
    clouds: tuple[Floats, Floats] | None = None,
) -> list[Row]:
    """Counts and metrics of a detection, one row for each direction and level.

    Parameters
    ----------
    detection : what was claimed.
    pair : what is true.
    threshold : see `component_truth`.
    overlap : count components by this threshold as well, in rows of level "overlap".
    clouds : the two clouds as the mixtures know them, where that is not in the pair's coordinates (after PCA).

    Returns
    -------
    Rows with `direction` ("appeared", "disappeared"), `level` ("component", "point", "object"), `tp`, `fp`, `fn`, `tn`
    and `accuracy`, `precision`, `recall`, `f1`; a method without mixtures has no components to count.

    Examples
    --------
    >>> from gmmcd_teach import simulate_pair
    >>> pair = simulate_pair("cargo_bag", 1)
    >>> perfect = Detection(pair.appeared, pair.disappeared)
    >>> [(row["direction"], row["level"], row["f1"]) for row in score(perfect, pair)][:2]
    [('appeared', 'point', 1.0), ('appeared', 'object', 1.0)]
    """
    before, after = clouds or (pair.before, pair.after)
    sides = {
        "appeared": (detection.after_mixture, detection.appeared_components, after, pair.after, pair.after_objects),
        "disappeared": (
            detection.before_mixture,
            detection.disappeared_components,
            before,
            pair.before,
            pair.before_objects,
        ),
    }
    rows = []
    for direction, (mixture, taken, fitted, points, objects) in sides.items():
        claimed, true = getattr(detection, direction), objects > 0
        tables = {"point": confusion(claimed, true), "object": object_confusion(points, claimed, objects)}
        if mixture is not None:
            tables = {"component": component_confusion(mixture, taken, fitted, true, threshold), **tables}
            if overlap is not None:
                tables["overlap"] = component_confusion(mixture, taken, fitted, true, overlap)
        rows += [as_row(table, direction=direction, level=level) for level, table in tables.items()]
    return rows


def objects_found(claimed: ArrayLike, numbers: ArrayLike, names: Sequence[str]) -> Row:
    """Which objects of a cloud were found: those of which more than half is claimed.

    Parameters
    ----------
    claimed : (N,) bool.
    numbers : (N,) the object that a point belongs to, 1 for the first name; 0 for none. An object without points is
        neither found nor missed.
    names : of the objects.

    Returns
    -------
    `claimed`, the share of all points, and the names `found` and `missed`, each joined by commas.

    Examples
    --------
    >>> objects_found([True, False, True, False], [1, 1, 1, 2], ["bag", "crate"])
    {'claimed': 0.5, 'found': 'bag', 'missed': 'crate'}
    """
    mask, number = np.asarray(claimed, dtype=bool), np.asarray(numbers)
    shares = {name: mask[number == i].mean() for i, name in enumerate(names, start=1) if (number == i).any()}
    found = [name for name, share in shares.items() if share > 0.5]
    missed = [name for name in shares if name not in found]
    return {"claimed": float(mask.mean()), "found": ", ".join(found), "missed": ", ".join(missed)}


def as_row(table: Confusion, **labels: Any) -> Row:
    """Labels, the four counts and the four metrics of a confusion table.

    Examples
    --------
    >>> as_row(Confusion(1, 0, 0, 1), level="point")["f1"]
    1.0
    """
    counts = {name: getattr(table, name) for name in ("tp", "fp", "fn", "tn")}
    return {**labels, **counts, **{name: getattr(table, name) for name in METRICS}}
