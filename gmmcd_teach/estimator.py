"""The mixture as a scikit-learn estimator, for pipelines and grid searches (chapter 18)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClusterMixin, DensityMixin
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data

from gmmcd_teach.clouds import Floats
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.mdl import description_length
from gmmcd_teach.mixture import GaussianMixture
from gmmcd_teach.starts import check_options, check_weights


class MDLGaussianMixture(DensityMixin, ClusterMixin, BaseEstimator):
    """Gaussian mixture that chooses its number of components by description length (Figueiredo & Jain 2002).

    scikit-learn's GaussianMixture fits the number of components that it is told. Its BayesianGaussianMixture is told
    an upper bound too, but leaves unneeded components in place with small weights, governed by a prior. Here unneeded
    components are annihilated, and the number kept is that of the shortest description; there is no prior to set.

    Parameters
    ----------
    max_components, min_components, tol, max_iter, update, init, cell_size, covariance_floor
        See `fit_mixture`. With fewer distinct samples than max_components, the maximum is lowered to their number; a
        mixture as `init` cannot be used then.
    random_state : seed of the starting means: None, int or RandomState.

    Attributes
    ----------
    mixture_ : the fitted `GaussianMixture`.
    weights_, means_, covariances_ : its arrays, (K,), (K, D) and (K, D, D).
    n_components_ : K, the number chosen.
    description_length_, n_iter_, history_ : see `MixtureFit`; n_iter_ counts M-steps.
    labels_ : (N,) component of each training sample.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = np.concatenate([rng.normal(0, 1, (300, 2)), rng.normal(9, 1, (300, 2))])
    >>> MDLGaussianMixture(max_components=8, tol=1e-4, random_state=0).fit(X).n_components_
    2
    """

    def __init__(
        self,
        max_components: int = 25,
        *,
        min_components: int = 1,
        tol: float = 1e-5,
        max_iter: int = 100,
        update: str = "batch",
        init: str | GaussianMixture = "random",
        cell_size: float | None = None,
        covariance_floor: float = 1e-6,
        random_state: Any = None,
    ) -> None:
        self.max_components = max_components
        self.min_components = min_components
        self.tol = tol
        self.max_iter = max_iter
        self.update = update
        self.init = init
        self.cell_size = cell_size
        self.covariance_floor = covariance_floor
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: object = None, sample_weight: ArrayLike | None = None) -> MDLGaussianMixture:
        """Fit to samples X of shape (N, D); sample_weight (N,) says how many points each stands for.

        Equal samples are counted together first, in sorted order: a weight of 3 is three samples, a weight of 0 none,
        and the order of the samples does not matter.
        """
        X = np.asarray(validate_data(self, X, dtype=np.float64, ensure_min_samples=2))
        counts = check_weights(sample_weight, len(X), 1, "sample_weight")
        distinct, member = np.unique(X[counts > 0], axis=0, return_inverse=True)
        options = self.get_params(deep=False)
        seed = int(check_random_state(options.pop("random_state")).randint(2**31 - 1))
        check_options(**options)
        for name in ("max_components", "min_components"):
            options[name] = min(options[name], len(distinct))
        weights = np.bincount(member.ravel(), counts[counts > 0])
        fit = fit_mixture(distinct, **options, point_weights=weights, rng=seed)
        self.mixture_ = fit.mixture
        self.weights_, self.means_, self.covariances_ = fit.mixture.weights, fit.mixture.means, fit.mixture.covariances
        self.n_components_ = fit.mixture.n_components
        self.description_length_ = fit.description_length
        self.history_ = fit.history
        starts = sum(record.event in ("start", "removed") for record in fit.history) + (self.cell_size is not None)
        self.n_iter_ = len(fit.history) - starts
        self.labels_ = fit.mixture.assign(X)
        return self

    def predict(self, X: ArrayLike) -> NDArray[np.intp]:
        """(N,) component of largest posterior for each sample."""
        samples = self._samples(X)
        return self.mixture_.assign(samples)

    def predict_proba(self, X: ArrayLike) -> Floats:
        """(N, K) posterior of each component; rows sum to 1."""
        samples = self._samples(X)
        return self.mixture_.responsibilities(samples)

    def score_samples(self, X: ArrayLike) -> Floats:
        """(N,) log-density of each sample."""
        samples = self._samples(X)
        return self.mixture_.log_density(samples)

    def score(self, X: ArrayLike, y: object = None) -> float:
        """Mean log-density of the samples, as scikit-learn's mixtures have it: larger is better."""
        return float(self.score_samples(X).mean())

    def description_length(self, X: ArrayLike) -> float:
        """Figueiredo & Jain's criterion on X, in nats: smaller is better."""
        samples = self._samples(X)
        return description_length(self.mixture_, samples)

    def sample(self, n_samples: int = 1) -> tuple[Floats, NDArray[np.intp]]:
        """n_samples points from the mixture, and the component of largest posterior of each."""
        check_is_fitted(self)
        points = self.mixture_.sample(n_samples, int(check_random_state(self.random_state).randint(2**31 - 1)))
        return points, self.mixture_.assign(points)

    def _samples(self, X: ArrayLike) -> Floats:
        check_is_fitted(self)
        return validate_data(self, X, dtype=np.float64, reset=False)
