"""Exercises of chapter 4: Gaussians and mixtures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register


def half_axes(covariance: Floats) -> Floats:
    """(D,) half-axes of the ellipsoid at two standard deviations, metres, the longest first."""
    return np.asarray(2 * np.sqrt(np.linalg.eigvalsh(covariance)[::-1]))


def log_gaussian(points: Floats, mean: Floats, covariance: Floats) -> Floats:
    """(N,) log-density of a Gaussian at each point."""
    return _log_gaussian(points, mean, covariance)


def _log_gaussian(
    points: Floats,
    mean: Floats,
    covariance: Floats,
    *,
    quadratic: float = 0.5,
    log_det: float = 0.5,
    log_two_pi: float | None = None,
    inverse: bool = True,
) -> Floats:
    d = len(mean)
    offset = points - mean  # (N, D)
    precision = np.linalg.inv(covariance) if inverse else covariance
    squared = ((offset @ precision) * offset).sum(axis=1)  # (N,)
    constant = (d / 2 if log_two_pi is None else log_two_pi) * np.log(2 * np.pi)
    return np.asarray(-quadratic * squared - log_det * np.linalg.slogdet(covariance)[1] - constant)


def responsibilities(log_densities: Floats, weights: Floats) -> Floats:
    """(N, K) posterior of each component for each point, from log p(s_i | theta_k) (N, K) and alpha (K,)."""
    log_joint = np.log(weights) + log_densities
    log_joint = log_joint - log_joint.max(axis=1, keepdims=True)
    joint = np.exp(log_joint)
    return np.asarray(joint / joint.sum(axis=1, keepdims=True))


def _underflowing(log_densities: Floats, weights: Floats) -> Floats:
    joint = weights * np.exp(log_densities)
    with np.errstate(invalid="ignore"):
        return np.asarray(joint / joint.sum(axis=1, keepdims=True))


def _as_printed(log_densities: Floats, weights: Floats) -> Floats:
    density = np.exp(log_densities)
    with np.errstate(invalid="ignore"):
        ratio = (weights * density).sum(axis=1) / density.sum(axis=1)
    return np.repeat(ratio[:, None], len(weights), axis=1)


def _guarded(log_densities: Floats, weights: Floats) -> Floats:
    joint = weights * np.exp(log_densities)
    return np.asarray(joint / (np.finfo(float).tiny + joint.sum(axis=1, keepdims=True)))


def _one_maximum(log_densities: Floats, weights: Floats) -> Floats:
    return _underflowing(log_densities - log_densities.max(), weights)


def _over_the_points(log_densities: Floats, weights: Floats) -> Floats:
    joint = weights * np.exp(log_densities - log_densities.max())
    return np.asarray(joint / joint.sum(axis=0))


def _hard(log_densities: Floats, weights: Floats) -> Floats:
    return np.eye(len(weights))[(np.log(weights) + log_densities).argmax(axis=1)]


def _covariances(d: int, n: int = 3) -> Iterator[Floats]:
    for seed in range(n):
        a = np.random.default_rng(seed).normal(size=(d, d))
        yield a @ a.T + 0.3 * np.eye(d)


def _gaussians() -> Iterator[tuple[Floats, Floats, Floats]]:
    for d in (2, 3):
        for covariance in _covariances(d, 2):
            rng = np.random.default_rng(d)
            yield rng.normal(size=(7, d)), rng.normal(size=d), covariance


def _log_densities() -> Iterator[tuple[Floats, Floats]]:
    """In the third case a far point stands beside a near one; in the last one every density underflows."""
    rng = np.random.default_rng(0)
    weights = np.array([0.6, 0.3, 0.1])
    for far in (0.0, -1.0):
        yield far + rng.normal(size=(5, 3)), weights
    yield np.array([[0.0, -1.0, -2.0], [-900.0, -901.0, -902.0]]), weights
    yield -900.0 + rng.normal(size=(5, 3)), weights


register(
    Exercise(
        "ex-04-1",
        lambda: ((covariance,) for covariance in _covariances(3)),
        half_axes,
        (
            Mistake(
                "these are variances, in square metres; take the square root",
                lambda c: np.linalg.eigvalsh(c)[::-1],
            ),
            Mistake("that is one standard deviation; we draw at two", lambda c: half_axes(c) / 2),
            Mistake(
                "you took the diagonal of the covariance: that is an ellipsoid along x, y, z. Its own axes are the "
                "eigenvectors, so take the eigenvalues",
                lambda c: 2 * np.sqrt(np.sort(np.diag(c))[::-1]),
            ),
            Mistake(
                "you took the diagonal of the covariance, in the order x, y, z. The ellipsoid's own axes are the "
                "eigenvectors, so take the eigenvalues",
                lambda c: 2 * np.sqrt(np.diag(c)),
            ),
            Mistake(
                "the right numbers in rising order: eigvalsh starts with the smallest, we want the longest first",
                lambda c: half_axes(c)[::-1],
            ),
            Mistake(
                "you doubled the variance before the root; two standard deviations are 2 sqrt(eigenvalue)",
                lambda c: half_axes(c) / np.sqrt(2),
            ),
            Mistake("these are whole axes; half of that reaches from the mean to the end", lambda c: 2 * half_axes(c)),
        ),
    ),
    Exercise(
        "ex-04-2",
        _gaussians,
        log_gaussian,
        (
            Mistake(
                "you are off by the log-determinant: without -log|Sigma| / 2 a wide Gaussian is as high as a thin one",
                lambda s, m, c: _log_gaussian(s, m, c, log_det=0),
            ),
            Mistake(
                "the log-determinant is not halved: the density has the square root of the determinant",
                lambda s, m, c: _log_gaussian(s, m, c, log_det=1),
            ),
            Mistake(
                "the log-determinant has the wrong sign: a wider Gaussian is lower",
                lambda s, m, c: _log_gaussian(s, m, c, log_det=-0.5),
            ),
            Mistake(
                "the squared distance is not halved: the exponent is -1/2 (s - mu)^T Sigma^-1 (s - mu)",
                lambda s, m, c: _log_gaussian(s, m, c, quadratic=1),
            ),
            Mistake(
                "you forgot (2 pi)^(-D/2): without it the density does not integrate to 1",
                lambda s, m, c: _log_gaussian(s, m, c, log_two_pi=0),
            ),
            Mistake(
                "2 pi comes once for each dimension: (D/2) log(2 pi), not log(2 pi) / 2",
                lambda s, m, c: _log_gaussian(s, m, c, log_two_pi=0.5),
            ),
            Mistake(
                "you multiplied by the covariance; the distance needs its inverse, so that wide directions count less",
                lambda s, m, c: _log_gaussian(s, m, c, inverse=False),
            ),
            Mistake(
                "that is the density itself; return its logarithm, which cannot underflow",
                lambda s, m, c: np.exp(_log_gaussian(s, m, c)),
            ),
        ),
    ),
    Exercise(
        "ex-04-3",
        _log_densities,
        responsibilities,
        (
            Mistake(
                "you forgot the weights: a component of weight 0.1 needs six times the density of one of weight 0.6",
                lambda log_p, a: responsibilities(log_p, np.ones_like(a)),
            ),
            Mistake(
                "right near the components, but far out all densities underflow to 0, and 0 / 0 is NaN. Subtract the "
                "largest log of each row before exp",
                _underflowing,
            ),
            Mistake(
                "you took the largest log of the whole table off: beside a near point, a far one still underflows to "
                "0 / 0. Take the largest of each row: axis=1, keepdims=True",
                _one_maximum,
            ),
            Mistake(
                "adding a tiny number hides the 0 / 0, but far points then belong to nobody: their rows sum to 0. "
                "Subtract the largest log of each row before exp",
                _guarded,
            ),
            Mistake(
                "that is Eq. 3 as printed (erratum P1): the same number for each component. The numerator needs "
                "alpha_k p(s | theta_k), and the denominator alpha_k too",
                _as_printed,
            ),
            Mistake(
                "you normalised over the points; for each point the K responsibilities sum to 1: axis=1",
                _over_the_points,
            ),
            Mistake(
                "these rows do not sum to 1: divide by the sum over the components (as erratum C6: the published "
                "predict_proba leaves this out)",
                lambda log_p, a: a * np.exp(log_p),
            ),
            Mistake(
                "that gives each point wholly to one component; responsibilities share it: exp, then divide by the sum",
                _hard,
            ),
            Mistake(
                "these are still logarithms; take exp at the end",
                lambda log_p, a: np.log(responsibilities(log_p, a)),
            ),
        ),
    ),
)
