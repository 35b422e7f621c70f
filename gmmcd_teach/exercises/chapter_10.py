"""Exercises of chapter 10: counting, scoring, and the capstone, the whole method from the student's own functions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.exercises.chapter_02 import voxel_centroids
from gmmcd_teach.exercises.chapter_07 import ground
from gmmcd_teach.exercises.chapter_08 import take_out
from gmmcd_teach.exercises.chapter_09 import claimed_points
from gmmcd_teach.exercises.checking import Exercise, Mistake, register
from gmmcd_teach.mixture import GaussianMixture

Bools = NDArray[np.bool_]
Counts = tuple[int, int, int, int]
Theta = tuple[Floats, Floats, Floats]
Fit = Callable[[Floats], Theta]


def four_counts(claimed: Bools, true: Bools) -> Counts:
    """TP, FP, FN and TN of two boolean arrays."""
    return (
        int((claimed & true).sum()),
        int((claimed & ~true).sum()),
        int((~claimed & true).sum()),
        int((~claimed & ~true).sum()),
    )


def f1_score(tp: int, fp: int, fn: int) -> float:
    """Eq. 23, and 1 where there was nothing to find and nothing was claimed."""
    return 2 * tp / (2 * tp + fp + fn) if tp + fp + fn else 1.0


def count_components(owners: Any, taken: Any, changed: Bools, n_components: int) -> Counts:
    """TP, FP, FN and TN of components; one is changed when more than half of its points are."""
    total = np.bincount(owners, minlength=n_components)
    hits = np.bincount(owners[changed], minlength=n_components)
    return four_counts(np.isin(np.arange(n_components), taken), hits > total / 2)


def assemble(
    before: Floats,
    after: Floats,
    leaf_size: float,
    fit: Fit,
    *,
    thinned: bool = True,
    mass: str = "normalized",
    on_voxels: bool = False,
    nearest: bool = False,
    exchanged: bool = False,
    other_side: bool = False,
) -> tuple[Bools, Bools]:
    """Capstone: what appeared and what disappeared, over all points; the options make the usual mistakes."""
    clouds = (before, after)
    voxels = tuple(voxel_centroids(points, leaf_size) for points in clouds)
    old, new = (fit(points) for points in (voxels if thinned else clouds))
    cost = ground(old[1], new[1])
    came = take_out(old[0], new[0], cost, mass=mass)  # indices into new
    went = take_out(new[0], old[0], cost.T, mass=mass)  # indices into old
    if other_side:
        came, went = went, came
    owners = [
        ground(points, theta[1]).argmin(axis=1) if nearest else GaussianMixture(*theta).assign(points)
        for points, theta in zip(voxels if on_voxels else clouds, (old, new), strict=True)
    ]
    appeared, disappeared = claimed_points(owners[1], came), claimed_points(owners[0], went)
    return (disappeared, appeared) if exchanged else (appeared, disappeared)


def _answers() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.random(40) < 0.3, rng.random(40) < 0.4


def _owners() -> Iterator[tuple[Any, ...]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        share = np.array([0.0, 0.2, 0.5, 0.7, 0.95, 0.3, 0.0])
        owners = rng.permutation(np.repeat(np.arange(7), [30, 25, 8, 12, 14, 15, 0]))  # the last one wins no point
        changed = rng.random(len(owners)) < share[owners]
        changed[np.flatnonzero(owners == 2)] = np.arange(8) < 4  # exactly half
        yield owners, np.array([4, 1]), changed, 7


def _rooms() -> Iterator[tuple[Any, ...]]:
    """Heaps in a row, unequal in size; above them a long one goes, and another comes."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        places = dict(enumerate((160, 40, 220, 90)))

        def heaps(extra: float, n: int, rng: np.random.Generator = rng, places: dict[int, int] = places) -> Floats:
            parts = [rng.normal([x, 0], [0.12, 0.25], (m, 2)) for x, m in places.items()]
            return np.concatenate([*parts, rng.normal([extra, 1.6], [0.9, 0.1], (n, 2))])

        yield heaps(0.5, 70), heaps(4.5, 110), 0.08, _small_fit


def _small_fit(points: Floats) -> Theta:
    return _fit_of(np.ascontiguousarray(points, dtype=np.float64).tobytes(), points.shape[1])


@cache  # an attempt, the solution and each usual mistake ask for the same clouds
def _fit_of(coordinates: bytes, n_dimensions: int) -> Theta:
    points = np.frombuffer(coordinates).reshape(-1, n_dimensions)
    mixture = fit_mixture(points, max_components=8, init="kmeans++", rng=0).mixture
    return mixture.weights, mixture.means, mixture.covariances


def _as_ratio(tp: int, fp: int, fn: int) -> float:
    with np.errstate(all="ignore"):
        p, r = np.float64(tp) / fp, np.float64(tp) / fn
        return float(2 * p * r / (p + r))


register(
    Exercise(
        "ex-10-1",
        _answers,
        four_counts,
        (
            Mistake(
                "false positives and false negatives are exchanged: a false positive was claimed and is not true",
                lambda claimed, true: tuple(four_counts(true, claimed)),
            ),
            Mistake(
                "your first count is all claims; a true positive must also be true: use & with both arrays",
                lambda claimed, true: (int(claimed.sum()), *four_counts(claimed, true)[1:]),
            ),
            Mistake(
                "your last count is everything not claimed; a true negative must also be not true",
                lambda claimed, true: (*four_counts(claimed, true)[:3], int((~claimed).sum())),
            ),
            Mistake(
                "those are shares; return counts, so that they can be added up over scenes",
                lambda claimed, true: tuple(n / len(true) for n in four_counts(claimed, true)),
            ),
            Mistake(
                "the order is TP, FP, FN, TN; yours is TP, TN, FP, FN",
                lambda claimed, true: tuple(four_counts(claimed, true)[i] for i in (0, 3, 1, 2)),
            ),
        ),
    ),
    Exercise(
        "ex-10-2",
        lambda: ((3, 1, 0), (2, 5, 1), (0, 4, 0), (0, 0, 3), (0, 0, 0)),
        f1_score,
        (
            Mistake(
                "that is the plain mean of precision and recall; F1 is the harmonic mean, pulled to the smaller one",
                lambda tp, fp, fn: (
                    ((tp / (tp + fp) if tp + fp else 0.0) + (tp / (tp + fn) if tp + fn else 0.0)) / 2
                    if tp + fp + fn
                    else 1.0
                ),
            ),
            Mistake(
                "TP counts twice, above and below: as it is, that is TP / (TP + FP + FN), the Jaccard index",
                lambda tp, fp, fn: tp / (tp + fp + fn) if tp + fp + fn else 1.0,
            ),
            Mistake(
                "with nothing to find and nothing claimed, all is right: return 1, not 0",
                lambda tp, fp, fn: 2 * tp / max(2 * tp + fp + fn, 1),
            ),
            Mistake(
                "you took precision as TP : FP and recall as TP : FN, as the paper words it (P9); divide by TP + FP "
                "and TP + FN",
                _as_ratio,
            ),
            Mistake(
                "false alarms do not lower your score: FP belongs below, too",
                lambda tp, fp, fn: 2 * tp / (2 * tp + fn) if tp + fp + fn and 2 * tp + fn else float(tp + fp + fn == 0),
            ),
        ),
    ),
    Exercise(
        "ex-10-3",
        _owners,
        count_components,
        (
            Mistake(
                "to overlap a change is not enough for a component: ask for more than half of its points",
                lambda owners, taken, changed, k: four_counts(
                    np.isin(np.arange(k), taken), np.bincount(owners[changed], minlength=k) > 0
                ),
            ),
            Mistake(
                "exactly half is not more than half, and a component with no point has not changed: use > and not >=",
                lambda owners, taken, changed, k: four_counts(
                    np.isin(np.arange(k), taken),
                    2 * np.bincount(owners[changed], minlength=k) >= np.bincount(owners, minlength=k),
                ),
            ),
            Mistake(
                "you counted points; here components are counted: four numbers that sum to n_components",
                lambda owners, taken, changed, k: four_counts(np.isin(owners, taken), changed),
            ),
            Mistake(
                "the component without points is missing from your counts: give np.bincount minlength=n_components",
                lambda owners, taken, changed, k: count_components(owners, taken, changed, owners.max() + 1),
            ),
            Mistake(
                "you compare with half of all changed points; compare with half of the component's own points",
                lambda owners, taken, changed, k: four_counts(
                    np.isin(np.arange(k), taken), np.bincount(owners[changed], minlength=k) > changed.sum() / 2
                ),
            ),
        ),
    ),
    Exercise(
        "ex-10-4",
        _rooms,
        assemble,
        (
            Mistake(
                "the two answers have changed places: return what appeared first, then what disappeared",
                lambda *room: assemble(*room, exchanged=True),
            ),
            Mistake(
                "the directions are turned around: take_out returns indices into its second weights. What appeared is "
                "taken out of the later mixture: take_out(old, new, cost)",
                lambda *room: assemble(*room, other_side=True),
            ),
            Mistake(
                "the weights are not re-normalised after a removal, so the extraction runs away (P14): emd needs "
                "mass='normalized'",
                lambda *room: assemble(*room, mass="partial"),
            ),
            Mistake(
                "your answers are for voxels; assign the points as they were given: one bool for each point",
                lambda *room: assemble(*room, on_voxels=True),
            ),
            Mistake(
                "you fitted the clouds unthinned; fit the voxel centroids, or dense surfaces outweigh the others",
                lambda *room: assemble(*room, thinned=False),
            ),
            Mistake(
                "you gave each point to the nearest mean; weights and covariances count: take the largest posterior",
                lambda *room: assemble(*room, nearest=True),
            ),
        ),
    ),
)
