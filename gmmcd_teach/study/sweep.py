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
from gmmcd_teach.metrics import component_truth
from gmmcd_teach.pca import principal_axes
from gmmcd_teach.study.fragments import merged_confusion
from gmmcd_teach.study.scans import scan
from gmmcd_teach.study.scores import Row, as_row, score
from gmmcd_teach.study.tables import OVERLAP

EDGE = 0.2
"""Metres from the outline of a scan that count as its edge."""

REACH = 0.3
"""Metres between centres within which fragments are merged: about half an object of the lab."""


def sweep_runs(scene: str, seed: int, **options: Any) -> list[Row]:
    """Detect what appeared in one pair of scans, and note what the claims of the paper speak of.

    Parameters
    ----------
    scene, seed : see `simulate_pair`; the seed starts EM, too.
    **options : see `detect_changes`.

    Returns
    -------
    The rows of `score` for appearances, and level "overlap", see `metric_runs`, and "merged", see `merged_confusion`.
    With each row what `notes` gives, `cpu` (seconds of computing, all steps), and `em_share`, EM's part of the time.

    Examples
    --------
    >>> rows = sweep_runs("cargo_bag", 1, leaf_size=0.1, max_components=5)
    >>> [row["level"] for row in rows]
    ['component', 'point', 'object', 'overlap', 'merged']
    """
    pair = scan(scene, seed)
    start = process_time()
    detection = detect_changes(pair.before, pair.after, rng=np.random.default_rng([seed]), **options)
    cpu = process_time() - start
    em_share = detection.seconds["em"] / detection.seconds["total"]
    return scored_rows(detection, pair, seen_by_em(pair, **options), cpu=cpu, em_share=em_share)


def scored_rows(detection: Detection, pair: ScenePair, clouds: tuple[Floats, Floats], **labels: Any) -> list[Row]:
    """The rows of `sweep_runs` for a detection that was made already; `clouds`: as the mixtures know them.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> detection = detect_changes(pair.before, pair.after, leaf_size=0.1, max_components=5)
    >>> scored_rows(detection, pair, (pair.before, pair.after))[0]["n_after"]
    5
    """
    labels = {**labels, **notes(detection, pair, clouds[1])}
    both = score(detection, pair, clouds=clouds, overlap=OVERLAP)
    rows = [{**labels, **row} for row in both if row["direction"] == "appeared"]
    mixture = detection.after_mixture
    if mixture is not None:
        merged = merged_confusion(mixture, detection.appeared_components, clouds[1], pair.appeared, REACH)
        rows.append({**labels, **as_row(merged, direction="appeared", level="merged")})
    return rows


def notes(detection: Detection, pair: ScenePair, after: Floats) -> Row:
    """What else is said of a detection.

    Returns
    -------
    `n_before`, `n_after` : components of the two mixtures, K*.
    `n_taken`, `n_true` : components extracted, and components that have mostly changed.
    `claimed` : share of the later points that is claimed.
    `found`, `missed` : names of objects of which more than half, or less, is claimed.
    `edge_false`, `edge_all` : share of the falsely claimed points, and of all unchanged points, at the scan's edge.

    Examples
    --------
    >>> pair = scan("cargo_bag", 1)
    >>> notes(Detection(pair.appeared, pair.disappeared), pair, pair.after)["found"]
    'cargo bag'
    """
    numbers, claimed = pair.after_objects, detection.appeared
    names = {name: numbers == i for i, name in enumerate(pair.object_names, start=1) if (numbers == i).any()}
    found = [name for name, mine in names.items() if claimed[mine].mean() > 0.5]
    edge, false = at_edge(pair.after), claimed & (numbers == 0)
    sizes: Row = {"n_before": 0, "n_after": 0, "n_taken": 0, "n_true": 0}
    if detection.before_mixture is not None and detection.after_mixture is not None:
        truth = component_truth(detection.after_mixture, after, pair.appeared)
        sizes = {
            "n_before": detection.before_mixture.n_components,
            "n_after": detection.after_mixture.n_components,
            "n_taken": len(detection.appeared_components),
            "n_true": int(truth.sum()),
        }
    return {
        **sizes,
        "claimed": float(claimed.mean()),
        "found": ", ".join(found),
        "missed": ", ".join(name for name in names if name not in found),
        "edge_false": float(edge[false].mean()) if false.any() else float("nan"),
        "edge_all": float(edge[numbers == 0].mean()),
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
