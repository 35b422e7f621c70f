"""One detection, looked at from every side: the runs behind the K sweep and the ablations (chapters 11 and 12)."""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from gmmcd_teach.clouds import Floats
from gmmcd_teach.detection import Detection, prepare
from gmmcd_teach.lab.pair import ScenePair
from gmmcd_teach.methods import detect_changes
from gmmcd_teach.metrics import changed_share, confusion
from gmmcd_teach.pca import principal_axes
from gmmcd_teach.study.fragments import merged_confusion
from gmmcd_teach.study.scans import scan
from gmmcd_teach.study.scores import Row, as_row, object_confusion, objects_found
from gmmcd_teach.study.tables import OVERLAP

EDGE = 0.2
"""Metres from the outline of a scan that count as its edge."""

REACH = 0.3
"""Metres between centres within which fragments are merged: about half an object of the lab."""


def sweep_runs(scene: str, seed: int, start: int = 0, **options: Any) -> list[Row]:
    """Detect what appeared in one pair of scans, and note what the claims of the paper speak of.

    Parameters
    ----------
    scene, seed : see `simulate_pair`.
    start : number of the random start of EM on these scans.
    **options : see `detect_changes`.

    Returns
    -------
    One row for each `level`: "component", "point", "object" and "overlap" as in `metric_runs`, and "merged", see
    `merged_confusion`. Each has counts and metrics, `n_before` and `n_after` (K* of both fits), `n_taken` and `n_true`
    (components extracted, and mostly changed), what `notes` gives, `cpu` (seconds of computing, all steps), and
    `em_share`, EM's part of the time.

    Examples
    --------
    >>> rows = sweep_runs("cargo_bag", 1, leaf_size=0.1, max_components=5)
    >>> [row["level"] for row in rows]
    ['component', 'point', 'object', 'overlap', 'merged']
    """
    pair = scan(scene, seed, frames=False)
    begun = process_time()
    detection = detect_changes(pair.before, pair.after, rng=np.random.default_rng([seed, start]), **options)
    cpu = process_time() - begun
    em_share = detection.seconds["em"] / detection.seconds["total"]
    return scored_rows(detection, pair, seen_by_em(pair, **options), cpu=cpu, em_share=em_share)


def scored_rows(detection: Detection, pair: ScenePair, clouds: tuple[Floats, Floats], **labels: Any) -> list[Row]:
    """The rows of `sweep_runs` for a detection by mixtures; `clouds`: the pair's, in the coordinates of the mixtures.

    Raises
    ------
    ValueError
        The method has no mixtures.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> detection = detect_changes(pair.before, pair.after, leaf_size=0.1, max_components=5)
    >>> scored_rows(detection, pair, (pair.before, pair.after))[0]["n_after"]
    5
    """
    mixture, taken, claimed = detection.after_mixture, detection.appeared_components, detection.appeared
    if mixture is None or detection.before_mixture is None:
        raise ValueError("scored_rows: a detection without mixtures; expected one of a method that fits them")
    owner = mixture.assign(clouds[1])  # (N,)
    share = changed_share(owner, pair.appeared, mixture.n_components)  # (K,)
    is_taken = np.isin(np.arange(mixture.n_components), taken)
    tables = {
        "component": confusion(is_taken, share > 0.5),
        "point": confusion(claimed, pair.appeared),
        "object": object_confusion(pair.after, claimed, pair.after_objects),
        "overlap": confusion(is_taken, share > OVERLAP),
        "merged": merged_confusion(mixture.means, taken, owner, pair.appeared, REACH),
    }
    sizes = {
        "n_before": detection.before_mixture.n_components,
        "n_after": mixture.n_components,
        "n_taken": len(taken),
        "n_true": int((share > 0.5).sum()),
    }
    labels = {**labels, **sizes, **notes(claimed, pair)}
    return [as_row(table, **labels, level=level) for level, table in tables.items()]


def notes(claimed: NDArray[np.bool_], pair: ScenePair) -> Row:
    """What else is said of the claimed points (N_after,).

    Returns
    -------
    `claimed`, `found`, `missed` : see `objects_found`.
    `edge_false`, `edge_all` : share of the falsely claimed points, and of all unchanged points, at the scan's edge.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> notes(pair.appeared, pair)["found"]
    'cargo bag'
    """
    edge, false = at_edge(pair.after), claimed & (pair.after_objects == 0)
    return {
        **objects_found(claimed, pair.after_objects, pair.object_names),
        "edge_false": float(edge[false].mean()) if false.any() else float("nan"),
        "edge_all": float(edge[pair.after_objects == 0].mean()),
    }


def at_edge(points: Floats, margin: float = EDGE) -> NDArray[np.bool_]:
    """(N,) bool: which points (N, 3) lie within `margin` metres of the outline of the cloud, seen along its least axis.

    The outline is the convex hull of the projection on the two widest principal axes.

    Examples
    --------
    >>> flat = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0), [0.0]), axis=-1).reshape(-1, 3)
    >>> int(at_edge(flat, 0.5).sum())
    16
    """
    flat = principal_axes(points).project(points, 2)  # (N, 2)
    sides = ConvexHull(flat).equations  # (F, 3) unit normals outwards, offsets
    inward = -(flat @ sides[:, :2].T + sides[:, 2])  # (N, F) metres
    return np.asarray(inward.min(axis=1) < margin)


def seen_by_em(
    pair: ScenePair,
    *,
    leaf_size: float | None = None,
    outlier_filter: bool = False,
    n_principal_axes: int | None = None,
    **others: Any,
) -> tuple[Floats, Floats]:
    """The two clouds, unthinned, in the coordinates of the mixtures: those of the pair, or on their principal axes.

    Examples
    --------
    >>> [cloud.shape[1] for cloud in seen_by_em(scan("cargo_bag", 1), leaf_size=0.1, n_principal_axes=2)]
    [2, 2]
    """
    if n_principal_axes is None:
        return pair.before, pair.after
    filtered = [prepare(cloud, leaf_size, outlier_filter) for cloud in (pair.before, pair.after)]
    axes = principal_axes(np.concatenate(filtered))
    return axes.project(pair.before, n_principal_axes), axes.project(pair.after, n_principal_axes)
