"""The estimator by scikit-learn's own checks, in a pipeline and a grid search, and against `fit_mixture`."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

from gmmcd_teach import CloudError, MDLGaussianMixture, description_length, fit_mixture


def two_groups(n: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.vstack([rng.normal(0, 1, (n, 2)), rng.normal(9, 1, (n, 2))])


SMALL = {"max_components": 5, "tol": 1e-4, "random_state": 0}


@parametrize_with_checks([MDLGaussianMixture(), MDLGaussianMixture(max_components=3, update="componentwise")])
def test_scikit_learns_own_checks(estimator, check):
    check(estimator)


@pytest.mark.parametrize(
    "options",
    [
        {"update": "componentwise", "init": "kmeans++"},
        {"min_components": 3, "max_iter": 7, "tol": 0.0},
        {"cell_size": 0.5, "covariance_floor": 0.01},
    ],
    ids=str,
)
def test_the_same_as_fit_mixture_on_sorted_samples(options):
    x = two_groups()
    estimator = MDLGaussianMixture(max_components=5, random_state=3, **options).fit(x)
    seed = int(np.random.RandomState(3).randint(2**31 - 1))
    fit = fit_mixture(np.unique(x, axis=0), 5, **options, rng=seed)
    np.testing.assert_array_equal(estimator.means_, fit.mixture.means)
    np.testing.assert_array_equal(estimator.weights_, fit.mixture.weights)
    np.testing.assert_array_equal(estimator.covariances_, fit.mixture.covariances)
    assert estimator.n_components_ == fit.mixture.n_components
    assert estimator.description_length_ == fit.description_length
    assert estimator.history_ == fit.history
    changes = [r.event for r in fit.history]
    starts = changes.count("start") + changes.count("removed") + ("polish" in changes)
    assert estimator.n_iter_ == len(changes) - starts > 0


def test_what_it_says_of_samples_is_what_its_mixture_says():
    x, new = two_groups(), np.random.default_rng(1).normal(4, 5, (50, 2))
    estimator = MDLGaussianMixture(**SMALL).fit(x)
    m = estimator.mixture_
    np.testing.assert_array_equal(estimator.labels_, m.assign(x))
    np.testing.assert_array_equal(estimator.predict(new), m.assign(new))
    np.testing.assert_array_equal(estimator.predict_proba(new), m.responsibilities(new))
    np.testing.assert_array_equal(estimator.score_samples(new), m.log_density(new))
    assert estimator.score(new) == pytest.approx(m.log_likelihood(new) / 50, rel=1e-12)
    assert estimator.description_length(new) == description_length(m, new)
    points, labels = estimator.sample(20)
    np.testing.assert_array_equal(points, estimator.sample(20)[0])
    np.testing.assert_array_equal(labels, m.assign(points))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_a_weight_of_3_is_three_samples_in_whatever_order(seed):
    rng = np.random.default_rng(seed)
    x, weights = rng.normal(size=(40, 2)), rng.integers(0, 4, 40)
    weights[0] = 1
    weighted = MDLGaussianMixture(**SMALL).fit(x, sample_weight=weights)
    repeated = MDLGaussianMixture(**SMALL).fit(rng.permutation(np.repeat(x, weights, axis=0)))
    np.testing.assert_array_equal(weighted.means_, repeated.means_)
    assert weighted.description_length_ == repeated.description_length_


def test_with_few_distinct_samples_the_maximum_is_lowered():
    x = np.repeat([[0.0, 0.0], [1.0, 1.0], [5.0, 0.0]], 4, axis=0)
    estimator = MDLGaussianMixture(max_components=25, min_components=10).fit(x)
    assert estimator.history_[0].n_components == 3
    assert estimator.n_components_ == 3


def test_in_a_pipeline():
    pipeline = make_pipeline(StandardScaler(), MDLGaussianMixture(**SMALL))
    labels = pipeline.fit(two_groups()).predict(two_groups())
    assert len(set(labels[:200])) == len(set(labels[200:])) == 1
    assert labels[0] != labels[-1]


def test_in_a_grid_search():
    grid = {"max_components": [1, 4], "init": ["random", "kmeans++"]}
    x = np.random.default_rng(0).permutation(two_groups())
    search = GridSearchCV(MDLGaussianMixture(**SMALL), grid, cv=3, error_score="raise").fit(x)
    assert search.best_params_["max_components"] == 4
    assert search.best_estimator_.n_components_ == 2


def test_it_is_cloned_with_all_its_settings():
    settings = {**SMALL, "init": "kmeans++", "update": "componentwise", "cell_size": 0.1, "max_iter": 9}
    assert clone(MDLGaussianMixture(**settings)).get_params().items() >= settings.items()


@pytest.mark.parametrize("method", ["predict", "predict_proba", "score_samples", "score", "description_length"])
def test_before_fit_it_says_so(method):
    with pytest.raises(NotFittedError):
        getattr(MDLGaussianMixture(), method)(two_groups())
    with pytest.raises(NotFittedError):
        MDLGaussianMixture().sample()


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"max_components": 0}, ValueError, "max_components = 0; expected a whole number of at least 1"),
        ({"max_components": "many"}, ValueError, "max_components = 'many'; expected a whole number"),
        ({"max_components": 3, "min_components": 4}, ValueError, "min_components = 4; expected at most"),
        ({"tol": -1.0}, ValueError, "tol = -1.0"),
        ({"init": "pca"}, ValueError, "init = 'pca'; expected one of"),
    ],
    ids=str,
)
def test_settings_out_of_range_are_refused_by_name(settings, error, words):
    with pytest.raises(error, match=words):
        MDLGaussianMixture(**settings).fit(two_groups())


@pytest.mark.parametrize("weights", [np.ones(3), -np.ones(400), np.zeros(400), np.full(400, np.nan), ["a"] * 400])
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(CloudError, match="sample_weight: "):
        MDLGaussianMixture().fit(two_groups(), sample_weight=weights)
