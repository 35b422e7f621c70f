"""Exercises of chapter 3: principal axes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def variance_along(points: Floats, direction: Floats) -> float:
    """Variance of the cloud along a direction of any length, square metres, with divisor N - 1."""
    return float(np.var(points @ direction / np.linalg.norm(direction), ddof=1))


def _axes(covariance: Floats) -> Floats:
    return np.linalg.eigh(covariance)[1].T[::-1]  # (D, D) rows, the widest first


def _pointing_up(axis: Floats) -> Floats:
    return axis * np.sign(axis[np.abs(axis).argmax()])


def widest_axis(points: Floats) -> Floats:
    """(D,) unit vector along which the cloud varies most; its entry of largest absolute value is positive."""
    return _pointing_up(_axes(np.cov(points.T))[0])


def project_on(points: Floats, reference: Floats, n_components: int) -> Floats:
    """(N, n) coordinates of points on the first axes of another cloud, measured from that cloud's mean."""
    return (points - reference.mean(axis=0)) @ _first_axes(reference, n_components).T


def _first_axes(points: Floats, n_components: int) -> Floats:
    return np.array([_pointing_up(axis) for axis in _axes(np.cov(points.T))[:n_components]])


def _narrowest(points: Floats, reference: Floats, n_components: int) -> Floats:
    return project_on(points, reference, points.shape[1])[:, -n_components:]


def _back_in_space(points: Floats, reference: Floats, n_components: int) -> Floats:
    scores = project_on(points, reference, n_components)
    return np.asarray(reference.mean(axis=0) + scores @ _first_axes(reference, n_components))


def _slab(seed: int, n: int = 40) -> Floats:
    """A cloud with three clearly different variances, turned and off the origin."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return (rng.normal(size=(n, 3)) * [2.0, 0.8, 0.1]) @ turn + rng.uniform(3, 5, 3)


def _directions() -> Iterator[tuple[Floats, Floats]]:
    return ((_slab(seed, 9), np.random.default_rng(9 + seed).uniform(1, 3, 3)) for seed in range(3))


def _by_columns(points: Floats) -> Floats:
    return _pointing_up(np.linalg.eigh(np.cov(points.T))[1][-1])


register(
    Exercise(
        "ex-03-1",
        _directions,
        variance_along,
        (
            Mistake(
                "the direction is not of length 1: divide it by its norm, or a longer arrow finds more variance",
                lambda s, u: np.var(s @ u, ddof=1),
            ),
            Mistake(
                "you forgot to take the mean off: that is the mean square distance from the origin's plane",
                lambda s, u: ((s @ u / np.linalg.norm(u)) ** 2).sum() / (len(s) - 1),
            ),
            Mistake(
                "that is the variance with divisor N; the mean comes from the same points, so take N - 1: ddof=1",
                lambda s, u: np.var(s @ u / np.linalg.norm(u)),
            ),
            Mistake(
                "that is the standard deviation, in metres; square it",
                lambda s, u: np.std(s @ u / np.linalg.norm(u), ddof=1),
            ),
            Mistake(
                "that is the variance of all coordinates together; project on the direction first: points @ direction",
                lambda s, u: np.trace(np.cov(s.T)),
            ),
        ),
    ),
    Exercise(
        "ex-03-2",
        lambda: ((_slab(seed),) for seed in range(4)),
        widest_axis,
        (
            Mistake(
                "that is the axis of least variance: eigh gives the eigenvalues in rising order, so take the last",
                lambda s: _pointing_up(_axes(np.cov(s.T))[-1]),
            ),
            Mistake(
                "that is a row of what eigh returns; the eigenvectors are its columns: vectors[:, -1]",
                _by_columns,
            ),
            Mistake(
                "you forgot to take the mean off: your axis points from the origin to the cloud",
                lambda s: _pointing_up(_axes(s.T @ s)[0]),
            ),
            Mistake(
                "the sign is turned around: an axis has no sign of its own, so make its entry of largest absolute "
                "value positive",
                lambda s: -widest_axis(s),
            ),
            Mistake(
                "that is longer or shorter than 1; return the eigenvector as it is, without its eigenvalue",
                lambda s: widest_axis(s) * np.linalg.eigvalsh(np.cov(s.T))[-1],
            ),
            Mistake(
                "that is the axis in which the coordinates differ most, x, y or z; principal axes may be oblique",
                lambda s: np.eye(s.shape[1])[np.var(s, axis=0).argmax()],
            ),
        ),
    ),
    Exercise(
        "ex-03-3",
        lambda: ((_slab(seed, 15), _slab(seed + 10), n) for seed, n in ((0, 2), (1, 1), (2, 2))),
        project_on,
        (
            Mistake(
                "each cloud got its own axes: then a thing that stayed has new coordinates. Take the reference's",
                lambda s, r, n: project_on(s, s, n),
            ),
            Mistake(
                "the axes are right, but you took off the mean of the points; take off that of the reference, "
                "or all that differs between the clouds moves",
                lambda s, r, n: project_on(s, r, n) - project_on(s, r, n).mean(axis=0),
            ),
            Mistake(
                "no mean was taken off: coordinates on principal axes start at the mean of the reference",
                lambda s, r, n: project_on(s, r, n) - project_on(np.zeros((1, s.shape[1])), r, n),
            ),
            Mistake(
                "you kept the axes of least variance: take those of the largest eigenvalues, widest first",
                lambda s, r, n: _narrowest(s, r, n)[:, ::-1],
            ),
            Mistake(
                "you kept the axes of least variance: take those of the largest eigenvalues, in falling order",
                _narrowest,
            ),
            Mistake(
                "these are points in space again; the answer has one number for each axis that was kept",
                lambda s, r, n: (
                    r.mean(axis=0) + project_on(s, r, n) @ np.array([_pointing_up(a) for a in _axes(np.cov(r.T))[:n]])
                ),
            ),
        ),
    ),
)
