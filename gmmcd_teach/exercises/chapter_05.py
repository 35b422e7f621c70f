"""Exercises of chapter 5: Expectation-Maximization."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

Parameters = tuple[Floats, Floats, Floats]


def new_means(points: Floats, w: Floats) -> Floats:
    """(K, D) means that the points (N, D) give with responsibilities w (N, K) (Eq. 9)."""
    return w.T @ points / w.sum(axis=0)[:, None]


def scatter(points: Floats, w: Floats, centres: Floats) -> Floats:
    """(K, D, D) weighted mean of (s_i - c_k)(s_i - c_k)^T."""
    x = points[:, None] - centres  # (N, K, D)
    return np.einsum("nk,nki,nkj->kij", w, x, x) / w.sum(axis=0)[:, None, None]


def new_covariances(points: Floats, w: Floats) -> Floats:
    """(K, D, D) covariances around the new means (Eq. 10)."""
    return scatter(points, w, new_means(points, w))


def log_joint(points: Floats, weights: Floats, means: Floats, covariances: Floats) -> Floats:
    """(N, K) log alpha_k + log p(s_i | theta_k)."""
    x = points[:, None] - means
    distance = np.einsum("nki,kij,nkj->nk", x, np.linalg.inv(covariances), x)
    return np.log(weights) - 0.5 * np.linalg.slogdet(2 * np.pi * covariances)[1] - 0.5 * distance


def softmax(a: Floats, axis: int = 1) -> Floats:
    """exp(a), divided by its sum along an axis, without underflow."""
    b = np.exp(a - a.max(axis=axis, keepdims=True))
    return np.asarray(b / b.sum(axis=axis, keepdims=True))


def plain(points: Floats, w: Floats) -> Parameters:
    """The M-step from responsibilities (N, K)."""
    return w.mean(axis=0), new_means(points, w), new_covariances(points, w)


def em_step(points: Floats, weights: Floats, means: Floats, covariances: Floats) -> Parameters:
    """One E-step and one M-step, in the log domain."""
    return plain(points, softmax(log_joint(points, weights, means, covariances)))


def underflowing(points: Floats, weights: Floats, means: Floats, covariances: Floats) -> Parameters:
    """The mistake of dividing densities that are 0 in floating point."""
    with np.errstate(invalid="ignore", under="ignore"):
        density = np.exp(log_joint(points, weights, means, covariances))
        return plain(points, density / density.sum(axis=1, keepdims=True))


def without_determinant(points: Floats, weights: Floats, means: Floats, covariances: Floats) -> Parameters:
    """The mistake of leaving the determinant out of the density."""
    x = points[:, None] - means
    distance = np.einsum("nki,kij,nkj->nk", x, np.linalg.inv(covariances), x)
    return plain(points, softmax(np.log(weights) - 0.5 * distance))


def around(points: Floats, weights: Floats, means: Floats, covariances: Floats) -> Parameters:
    """The mistake of taking the covariances around the old means."""
    w = softmax(log_joint(points, weights, means, covariances))
    return w.mean(axis=0), new_means(points, w), scatter(points, w, means)


def responsibility_cases() -> Iterator[tuple[Floats, Floats]]:
    """Points and responsibilities; the supports differ from each other and from N."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield rng.normal(size=(12, 2 + seed % 2)) + 4.0, rng.dirichlet([0.5, 1.0, 2.0], size=12)


def em_cases() -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    """Points and the parameters of three unlike Gaussians; the last cloud has a point beyond all of them."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=(15, 2))
        if seed == 2:
            points[0] = [60.0, -40.0]
        shapes = rng.normal(size=(3, 2, 2))
        covariances = np.eye(2) * np.array([0.2, 0.5, 1.0])[:, None, None] + 0.1 * shapes @ shapes.swapaxes(1, 2)
        yield points, np.array([0.2, 0.3, 0.5]), rng.normal(size=(3, 2)), covariances


register(
    Exercise(
        "ex-05-1",
        responsibility_cases,
        new_means,
        (
            Mistake(
                "you divided by N. Divide the sum of each component by its own support, w.sum(axis=0): "
                "a component that owns few points would otherwise be drawn towards the origin",
                lambda s, w: w.T @ s / len(s),
            ),
            Mistake(
                "the sums are not divided: a mean is the weighted sum over the support, w.sum(axis=0)",
                lambda s, w: w.T @ s,
            ),
            Mistake(
                "every row is the mean of the whole cloud: the responsibilities are missing. "
                "Count each point by w[i, k]",
                lambda s, w: np.tile(s.mean(axis=0), (w.shape[1], 1)),
            ),
            Mistake(
                "each point went whole to its likeliest component. That is k-means; in EM points are shared: use w",
                lambda s, w: new_means(s, np.eye(w.shape[1])[w.argmax(axis=1)] + 1e-300),
            ),
            Mistake(
                "the answer is lying on its side: rows are components, columns are coordinates, (K, D). "
                "Use w.T @ points, not points.T @ w",
                lambda s, w: (s.T @ w) / w.sum(axis=0),
            ),
        ),
    ),
    Exercise(
        "ex-05-2",
        responsibility_cases,
        new_covariances,
        (
            Mistake(
                "you divided by N. Divide by the support of the component, w[:, k].sum(): "
                "with N a small component comes out far too thin",
                lambda s, w: new_covariances(s, w) * w.sum(axis=0)[:, None, None] / len(s),
            ),
            Mistake(
                "the weights are missing inside the sum: every component sees the whole cloud. "
                "Multiply each outer product by w[i, k] (this is the w without i that the paper prints)",
                lambda s, w: scatter(s, np.ones_like(w), new_means(s, w)),
            ),
            Mistake(
                "you took the distances from the mean of the whole cloud. Each component has its own mean, Eq. 9",
                lambda s, w: scatter(s, w, np.tile(s.mean(axis=0), (w.shape[1], 1))),
            ),
            Mistake(
                "that is the mean of s s^T around the origin: nothing was taken off. Subtract the component's mean",
                lambda s, w: scatter(s, w, np.zeros((w.shape[1], s.shape[1]))),
            ),
            Mistake(
                "the weights are counted twice: w[i, k] belongs once into each term, not on both factors",
                lambda s, w: scatter(s, w**2, new_means(s, w)) * ((w**2).sum(axis=0) / w.sum(axis=0))[:, None, None],
            ),
            Mistake(
                "those are the variances alone. A covariance has the products of different coordinates, too: (K, D, D)",
                lambda s, w: np.diagonal(new_covariances(s, w), axis1=1, axis2=2),
            ),
        ),
    ),
    Exercise(
        "ex-05-3",
        em_cases,
        em_step,
        (
            Mistake(
                "the weights alpha are missing in the E-step. Eq. 7 multiplies each density by its weight: "
                "add np.log(weights)",
                lambda s, alpha, mu, sigma: em_step(s, np.full(len(alpha), 1 / len(alpha)), mu, sigma),
            ),
            Mistake(
                "the determinant is missing in the density: without it a wide component is as high as a thin one. "
                "Subtract half of np.linalg.slogdet(2 * np.pi * covariances)[1]",
                without_determinant,
            ),
            Mistake(
                "you normalised along the wrong axis. A point is shared out among components: each row of w sums to 1",
                lambda s, alpha, mu, sigma: plain(s, softmax(log_joint(s, alpha, mu, sigma), axis=0)),
            ),
            Mistake(
                "the covariances are taken around the old means. Eq. 10 needs the new ones; "
                "the old ones add the outer product of the shift",
                around,
            ),
            Mistake(
                "a point far from all components has density 0 under each, and 0 / 0 is NaN. Stay with logarithms: "
                "take the largest of each row off before np.exp",
                underflowing,
            ),
            Mistake(
                "the weights did not change: the M-step sets them, too, to the mean of each column of w",
                lambda s, alpha, mu, sigma: (alpha, *em_step(s, alpha, mu, sigma)[1:]),
            ),
            Mistake(
                "your responsibilities are alpha for every point, so all components become the same. That is Eq. 7 as "
                "the paper prints it: write p(s | theta_k), not p(s | Theta)",
                lambda s, alpha, mu, sigma: plain(s, np.tile(alpha, (len(s), 1))),
            ),
        ),
    ),
)
