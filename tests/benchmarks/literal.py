"""The component-wise algorithm as published: for each component, every responsibility is computed anew."""

from __future__ import annotations

import numpy as np

from gmmcd_teach import GaussianMixture
from gmmcd_teach.mdl import mdl_penalty

TINY = np.finfo(float).tiny


def gaussian(points: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(N,) densities of one Gaussian, in NumPy, a component at a time."""
    x = points - mean
    distance = np.einsum("ni,ij,nj->n", x, np.linalg.inv(covariance), x)
    return np.exp(-0.5 * distance) / np.sqrt(np.linalg.det(2 * np.pi * covariance))


def sweep(
    points: np.ndarray, mixture: GaussianMixture, min_components: int = 1, floor: float = 1e-6
) -> GaussianMixture:
    """One turn for every component, with the weights of `gmmcd_teach.componentwise`."""
    alpha, means, covariances = (a.copy() for a in (mixture.weights, mixture.means, mixture.covariances))
    density = np.column_stack([gaussian(points, m, c) for m, c in zip(means, covariances, strict=True)])  # (N, K)
    k = 0
    while k < len(alpha):
        half = 4.5 if len(alpha) > min_components else 0.0  # P / 2 in three dimensions
        w = density * alpha + TINY
        w /= w.sum(axis=1, keepdims=True)  # Eq. 7, for every component
        support = w.sum(axis=0)
        if len(alpha) > min_components and support[k] <= half:
            alpha, means, covariances = (np.delete(a, k, axis=0) for a in (alpha, means, covariances))
            density, alpha = np.delete(density, k, axis=1), alpha / alpha.sum()
            continue
        means[k] = w[:, k] @ points / support[k]  # Eq. 9
        x = points - means[k]
        covariances[k] = (w[:, k, None] * x).T @ x / support[k] + floor * np.eye(3)  # Eq. 10
        claims = np.where(support > half, support - half, support)  # Eq. 11
        share = claims[k] / claims.sum()
        others = np.arange(len(alpha)) != k
        alpha[others] *= (1 - share) / (alpha[others].sum() or 1.0)
        alpha[k] = share
        density[:, k] = gaussian(points, means[k], covariances[k])
        k += 1
    return GaussianMixture(alpha / alpha.sum(), means, covariances)


def log_likelihood(points: np.ndarray, mixture: GaussianMixture) -> float:
    """Eq. 4."""
    parts = zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    return float(np.log(sum(a * gaussian(points, m, c) for a, m, c in parts) + TINY).sum())


def path(points: np.ndarray, mixture: GaussianMixture, tol: float = 1e-5, max_iter: int = 100) -> tuple[float, int]:
    """From a start down to one component; the least description length met, and how many sweeps it took."""
    best, sweeps = np.inf, 0
    while True:
        here, steps = log_likelihood(points, mixture), 0
        while steps < max_iter:
            k, before = mixture.n_components, here
            mixture, sweeps = sweep(points, mixture), sweeps + 1
            here = log_likelihood(points, mixture)
            died = mixture.n_components < k
            steps = 1 if died else steps + 1
            if not died and abs(here - before) < tol * abs(here):
                break
        best = min(best, mdl_penalty(mixture.weights, len(points), 3) - here)
        if mixture.n_components == 1:
            return best, sweeps
        mixture = mixture.subset(np.delete(np.arange(mixture.n_components), mixture.weights.argmin()))
