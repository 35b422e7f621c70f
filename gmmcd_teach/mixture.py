"""The Gaussian mixture: a weighted sum of Gaussians, its densities and its responsibilities (chapter 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import CloudError, Floats, check_points

LARGEST = 1e100  # metres: squares of larger coordinates, divided by small variances, leave the range of floats
BLOCK = 2048  # points handled at a time: K of their densities fit the processor's cache


@dataclass(frozen=True, eq=False)
class GaussianMixture:
    """A mixture Theta = {alpha_k, mu_k, Sigma_k} of K Gaussians in D dimensions (Eqs. 1 and 2).

    Parameters
    ----------
    weights : (K,) alpha, non-negative, summing to 1.
    means : (K, D) mu, metres.
    covariances : (K, D, D) Sigma, square metres, symmetric and positive definite.

    Raises
    ------
    CloudError
        The shapes disagree, a number is not finite, the weights are negative or do not sum to 1,
        or a covariance is not symmetric or not positive definite.

    Examples
    --------
    >>> coin = GaussianMixture([0.5, 0.5], [[-1.0], [1.0]], [[[0.1]], [[0.1]]])
    >>> coin.assign([[-0.8], [2.0]])
    array([0, 1])
    """

    weights: Floats
    means: Floats
    covariances: Floats

    def __post_init__(self) -> None:
        for name in ("weights", "means", "covariances"):
            array = floats(getattr(self, name), f"mixture {name}").copy()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        k, d = self.means.shape if self.means.ndim == 2 else (0, 0)
        if k * d == 0 or self.weights.shape != (k,) or self.covariances.shape != (k, d, d):
            shapes = f"{self.weights.shape}, {self.means.shape}, {self.covariances.shape}"
            raise CloudError(
                f"mixture: weights, means, covariances of shapes {shapes}; expected (K,), (K, D), (K, D, D)"
            )
        if not all(np.isfinite(a).all() for a in (self.weights, self.means, self.covariances)):
            raise CloudError("mixture: NaN or infinity among weights, means or covariances")
        if self.weights.min() < 0 or abs(self.weights.sum() - 1) > 1e-8:
            raise CloudError(
                f"mixture weights: from {self.weights.min():.3g}, sum {self.weights.sum():.9g}; expected >= 0, sum 1"
            )
        self.whitening  # noqa: B018  a covariance that is not positive definite is told here

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy is made anew: checked, and as unchangeable as the first."""
        return GaussianMixture, (self.weights, self.means, self.covariances)

    @property
    def n_components(self) -> int:
        """K, the number of Gaussians."""
        return len(self.weights)

    @property
    def n_dimensions(self) -> int:
        """D, the dimension of the points."""
        return self.means.shape[1]

    @cached_property
    def whitening(self) -> tuple[Floats, Floats]:
        """W (K, D, D) with Sigma^-1 = W^T W, and (K,) the log-joint at the means: |W (s - mu)|^2 / 2 more than at s.

        Examples
        --------
        >>> GaussianMixture([1.0], [[0.0]], [[[4.0]]]).whitening[0].ravel()
        array([0.5])
        """
        factors = np.asarray(np.linalg.inv(cholesky_factors(self.covariances)), dtype=np.float64)
        log_volume = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)  # (K,) -log |Sigma| / 2
        with np.errstate(divide="ignore"):  # a weight of 0 has the logarithm -inf
            peak = np.log(self.weights) + log_volume - self.n_dimensions / 2 * np.log(2 * np.pi)
        return factors, np.asarray(peak, dtype=np.float64)

    def log_joint(self, points: ArrayLike) -> Floats:
        """(K, N) log alpha_k + log p(s_i | theta_k): the terms of the sum in Eq. 1, components as rows.

        Each distance is taken from the component's own mean, so nothing is lost far from the origin.
        """
        s = self._check(points)
        factors, peak = self.whitening
        z = (factors[k] @ (s - self.means[k]).T for k in range(self.n_components))  # (D, N) each, whitened
        return np.stack([peak[k] - 0.5 * (z_k**2).sum(axis=0) for k, z_k in enumerate(z)])

    def log_density(self, points: ArrayLike) -> Floats:
        """(N,) log p(s_i | Theta), the logarithm of Eq. 1, by log-sum-exp."""
        return self._in_blocks(points, lambda s: _log_sum_exp(self.log_joint(s)))

    def responsibilities(self, points: ArrayLike) -> Floats:
        """(N, K) posterior w_ik that component k produced point i (Eqs. 3 and 7, put right); rows sum to 1."""

        def posterior(s: Floats) -> Floats:
            log_joint = self.log_joint(s)
            return np.exp(log_joint - _log_sum_exp(log_joint)).T

        return self._in_blocks(points, posterior)

    def assign(self, points: ArrayLike) -> NDArray[np.intp]:
        """(N,) the component of largest posterior, weights included."""
        return self._in_blocks(points, lambda s: self.log_joint(s).argmax(axis=0))

    def log_likelihood(self, points: ArrayLike) -> float:
        """The sum of the log-densities of the points (Eq. 4), in nats."""
        return float(self.log_density(points).sum())

    def subset(self, indices: ArrayLike) -> GaussianMixture:
        """The mixture of the named components alone, re-normalised to total weight 1.

        Raises
        ------
        CloudError
            An index without a component, or no weight left.
        """
        kept = np.atleast_1d(np.asarray(indices))
        try:
            weights = self.weights[kept] if kept.size else np.zeros(1)
        except IndexError:
            raise CloudError(f"mixture subset: expected integers from 0 to {self.n_components - 1}") from None
        if weights.sum() <= 0:
            raise CloudError("mixture subset: no component of positive weight left; keep at least one")
        return GaussianMixture(weights / weights.sum(), self.means[kept], self.covariances[kept])

    def moved(self, offset: ArrayLike) -> GaussianMixture:
        """The mixture of the points s + offset, with offset (D,) in metres; a CloudError for another shape."""
        by = floats(offset, "offset")
        if by.shape != (self.n_dimensions,):
            raise CloudError(f"offset: shape {by.shape}; expected ({self.n_dimensions},)")
        return GaussianMixture(self.weights, self.means + by, self.covariances)

    def sample(self, n: int, rng: int | np.random.Generator = 0) -> Floats:
        """(n, D) points drawn from the mixture; a ValueError where n or rng cannot be used."""
        if not isinstance(n, Integral) or n < 1:
            raise ValueError(f"n = {n!r}; expected a whole number of at least 1")
        rng = generator(rng)
        k = rng.choice(self.n_components, size=n, p=self.weights)  # (n,)
        noise = rng.standard_normal((n, self.n_dimensions, 1))
        return self.means[k] + (cholesky_factors(self.covariances)[k] @ noise)[..., 0]

    def _check(self, points: ArrayLike) -> Floats:
        s = check_points(points, dimensions=(self.n_dimensions,))
        if np.abs(s).max() > LARGEST:
            raise CloudError(f"points: coordinates beyond {LARGEST:.0e} m; their squares overflow")
        return s

    def _in_blocks(self, points: ArrayLike, function: Callable[[Floats], NDArray[Any]]) -> NDArray[Any]:
        s = self._check(points)
        return np.concatenate([function(s[start : start + BLOCK]) for start in range(0, len(s), BLOCK)])


def floats(values: ArrayLike, name: str) -> Floats:
    """The values as a float64 array of any shape; a CloudError names the argument that is no array of numbers.

    Examples
    --------
    >>> floats([1, 2], "weights")
    array([1., 2.])
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CloudError(f"{name}: not an array of numbers") from None


def generator(rng: int | np.random.Generator) -> np.random.Generator:
    """The generator itself, or one from a seed; a ValueError says what can be one.

    Examples
    --------
    >>> int(generator(0).integers(100)), int(generator(np.random.default_rng(0)).integers(100))
    (85, 85)
    """
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError):
        raise ValueError(f"rng = {rng!r}; expected a whole number of at least 0, or a Generator") from None


def check_mixture(value: object, name: str) -> GaussianMixture:
    """The mixture, or a CloudError that names the argument that is none.

    Examples
    --------
    >>> check_mixture(GaussianMixture([1.0], [[0.0]], [[[1.0]]]), "before").n_components
    1
    """
    if not isinstance(value, GaussianMixture):
        instead = ", its .mixture" if isinstance(getattr(value, "mixture", None), GaussianMixture) else ""
        raise CloudError(f"{name}: {type(value).__name__}; expected a GaussianMixture{instead}")
    return value


def cholesky_factors(covariances: Floats) -> Floats:
    """(K, D, D) lower triangles with Sigma_k = C C^T; a CloudError names the component that has none.

    Examples
    --------
    >>> float(cholesky_factors(np.array([[[4.0]]]))[0, 0, 0])
    2.0
    """
    if (covariances != covariances.swapaxes(1, 2)).any():
        skew = np.abs(covariances - covariances.swapaxes(1, 2)).max(axis=(1, 2))  # (K,)
        if skew.max() > 1e-8 * np.abs(covariances).max():
            raise CloudError(f"covariance of component {skew.argmax()}: not symmetric")
    try:
        return np.asarray(np.linalg.cholesky(covariances), dtype=np.float64)
    except np.linalg.LinAlgError:
        smallest = np.linalg.eigvalsh(covariances)[:, 0]  # (K,)
        k = int(smallest.argmin())
        message = f"smallest eigenvalue {smallest[k]:.3g}, not positive definite; raise covariance_floor"
        raise CloudError(f"covariance of component {k}: {message}") from None


def _log_sum_exp(log_joint: Floats) -> Floats:
    """(N,) log of the sum over components of (K, N) exponentials, the largest taken out first."""
    top = log_joint.max(axis=0)
    total = np.exp(log_joint - top).sum(axis=0)
    return np.asarray(top + np.log(total), dtype=np.float64)
