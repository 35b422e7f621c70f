"""Exercises of chapter 12: what a projection keeps, axes for two clouds, and when an object is lost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register
from gmmcd_teach.pca import PrincipalAxes, principal_axes

Bools = NDArray[np.bool_]


def spread(points: Floats) -> tuple[Floats, Floats]:
    """Variances (D,) along the principal axes, the widest first, and these axes (D, D), one a row."""
    found = principal_axes(points)
    return found.variances, found.axes


def variance_kept(points: Floats, n: int) -> float:
    """Share of the variance that is left on the first n principal axes."""
    variances, _ = spread(points)
    return float(variances[:n].sum() / variances.sum())


def project_both(before: Floats, after: Floats, n: int) -> tuple[Floats, Floats]:
    """Both clouds on the first n principal axes of the two together."""
    axes = principal_axes(np.concatenate([before, after]))
    return axes.project(before, n), axes.project(after, n)


def distance_kept(points: Floats, changed: Bools, n: int) -> float:
    """Share of the distance between object and rest that survives the projection."""
    _, axes = spread(points)
    step = points[changed].mean(axis=0) - points[~changed].mean(axis=0)
    return float(np.linalg.norm(axes[:n] @ step) / np.linalg.norm(step))


def _clouds() -> Iterator[tuple[Any, ...]]:
    for seed, n in ((0, 2), (1, 1), (2, 2)):
        rng = np.random.default_rng(seed)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        yield rng.normal(size=(200, 3)) * [2.0, 1.0, 0.4] @ turn + [3.0, -1.0, 2.0], n


def _pairs() -> Iterator[tuple[Any, ...]]:
    for (cloud, n), offset in zip(_clouds(), (0.8, 1.5, -1.0), strict=True):
        yield cloud[:120], cloud[120:] + offset, n


def _objects() -> Iterator[tuple[Any, ...]]:
    for cloud, n in _clouds():
        changed = np.arange(len(cloud)) < 40
        yield cloud + np.where(changed[:, None], [0.5, 0.3, 0.9], 0.0), changed, n


def _on(axes: PrincipalAxes, before: Floats, after: Floats, n: int, last: bool = False) -> tuple[Floats, Floats]:
    d = before.shape[1]
    kept = slice(d - n, d) if last else slice(n)
    return axes.project(before, d)[:, kept], axes.project(after, d)[:, kept]


def _own_means(before: Floats, after: Floats, n: int) -> tuple[Floats, Floats]:
    old, new = project_both(before, after, n)
    return old - old.mean(axis=0), new - new.mean(axis=0)


def _not_centred(before: Floats, after: Floats, n: int) -> tuple[Floats, Floats]:
    _, axes = spread(np.concatenate([before, after]))
    return before @ axes[:n].T, after @ axes[:n].T


register(
    Exercise(
        "ex-12-1",
        _clouds,
        variance_kept,
        (
            Mistake(
                "you summed the last axes: np.linalg.eigh gives the smallest variance first; turn the order around",
                lambda points, n: spread(points)[0][::-1][:n].sum() / spread(points)[0].sum(),
            ),
            Mistake(
                "that is the share that is lost; the share that is kept is 1 less that",
                lambda points, n: 1 - variance_kept(points, n),
            ),
            Mistake(
                "that is a variance in square metres; divide by the sum over all axes",
                lambda points, n: spread(points)[0][:n].sum(),
            ),
            Mistake(
                "you took standard deviations; variances add up along axes, standard deviations do not",
                lambda points, n: np.sqrt(spread(points)[0])[:n].sum() / np.sqrt(spread(points)[0]).sum(),
            ),
            Mistake(
                "the mean is still in there: subtract it before you multiply, or use np.cov",
                lambda points, n: np.linalg.eigvalsh(points.T @ points)[::-1][:n].sum() / np.trace(points.T @ points),
            ),
            Mistake(
                "those are the variances along x and y; the principal axes are the eigenvectors of the covariance",
                lambda points, n: points.var(axis=0)[:n].sum() / points.var(axis=0).sum(),
            ),
        ),
    ),
    Exercise(
        "ex-12-2",
        _pairs,
        project_both,
        (
            Mistake(
                "each cloud has axes of its own in your answer; then the two cannot be compared. Take the axes of both "
                "together",
                lambda before, after, n: (
                    principal_axes(before).project(before, n),
                    principal_axes(after).project(after, n),
                ),
            ),
            Mistake(
                "you kept the axes of least variance; keep the first n, the widest",
                lambda before, after, n: _on(
                    principal_axes(np.concatenate([before, after])), before, after, n, last=True
                ),
            ),
            Mistake(
                "you centred each cloud on its own mean, and so moved one against the other; subtract one common mean",
                _own_means,
            ),
            Mistake(
                "nothing is centred; subtract the common mean before you project",
                _not_centred,
            ),
            Mistake(
                "those are the axes and the mean of the first cloud alone; concatenate both clouds first",
                lambda before, after, n: _on(principal_axes(before), before, after, n),
            ),
        ),
    ),
    Exercise(
        "ex-12-3",
        _objects,
        distance_kept,
        (
            Mistake(
                "that is the share that is lost along the dropped axes",
                lambda points, changed, n: np.sqrt(1 - distance_kept(points, changed, n) ** 2),
            ),
            Mistake(
                "that is the share of the squared distance; take the square root",
                lambda points, changed, n: distance_kept(points, changed, n) ** 2,
            ),
            Mistake(
                "that is a length in metres; divide by the distance in space",
                lambda points, changed, n: np.linalg.norm(
                    spread(points)[1][:n] @ (points[changed].mean(axis=0) - points[~changed].mean(axis=0))
                ),
            ),
            Mistake(
                "you took the axes of the object's own points; the method projects on those of the whole cloud",
                lambda points, changed, n: (
                    np.linalg.norm(
                        spread(points[changed])[1][:n] @ (points[changed].mean(axis=0) - points[~changed].mean(axis=0))
                    )
                    / np.linalg.norm(points[changed].mean(axis=0) - points[~changed].mean(axis=0))
                ),
            ),
            Mistake(
                "you kept the axes of least variance; the widest come first",
                lambda points, changed, n: (
                    np.linalg.norm(
                        spread(points)[1][-n:] @ (points[changed].mean(axis=0) - points[~changed].mean(axis=0))
                    )
                    / np.linalg.norm(points[changed].mean(axis=0) - points[~changed].mean(axis=0))
                ),
            ),
        ),
    ),
)
