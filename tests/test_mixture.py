"""The Gaussian mixture against SciPy and scikit-learn, and against what theory says of moved and scaled space."""

from __future__ import annotations

import copy
import pickle
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture as SklearnMixture

from gmmcd_teach import CloudError, GaussianMixture
from gmmcd_teach.features import natural_parameters, quadratic_features
from gmmcd_teach.mixture import cholesky_factors

SEEDS = st.integers(0, 2**32 - 1)
BOTH = pytest.mark.parametrize(("k", "d"), [(1, 1), (4, 2), (25, 3), (3, 6)])


def random_mixture(rng: np.random.Generator, k: int, d: int) -> GaussianMixture:
    roots = rng.normal(size=(k, d, d)) + 2 * np.eye(d)
    return GaussianMixture(
        rng.dirichlet(np.full(k, 3.0)), rng.uniform(-5, 5, (k, d)), roots @ roots.swapaxes(1, 2) / 4 + 0.1 * np.eye(d)
    )


def sklearn_twin(m: GaussianMixture) -> SklearnMixture:
    twin = SklearnMixture(m.n_components)
    twin.weights_, twin.means_, twin.covariances_ = m.weights, m.means, m.covariances
    twin.precisions_cholesky_ = np.linalg.inv(np.linalg.cholesky(m.covariances)).swapaxes(1, 2)
    return twin


@BOTH
def test_densities_and_responsibilities_equal_scipys_and_scikit_learns(k, d):
    rng = np.random.default_rng(k)
    m, points = random_mixture(rng, k, d), rng.uniform(-8, 8, (2500, d))  # more than two blocks
    each = np.column_stack([multivariate_normal(m.means[j], m.covariances[j]).logpdf(points) for j in range(k)])
    joint = np.log(m.weights) + each  # (N, K)
    np.testing.assert_allclose(m.log_joint(points).T, joint, rtol=1e-10)
    np.testing.assert_allclose(m.log_density(points), logsumexp(joint, axis=1), rtol=1e-10)
    np.testing.assert_allclose(m.log_likelihood(points), logsumexp(joint, axis=1).sum(), rtol=1e-10)
    twin = sklearn_twin(m)
    np.testing.assert_allclose(m.log_density(points), twin.score_samples(points), rtol=1e-10)
    np.testing.assert_allclose(m.responsibilities(points), twin.predict_proba(points), atol=1e-10)
    np.testing.assert_array_equal(m.assign(points), twin.predict(points))


@BOTH
def test_the_logarithm_of_a_gaussian_is_linear_in_the_features(k, d):
    rng = np.random.default_rng(k)
    m, points = random_mixture(rng, k, d), rng.uniform(-8, 8, (50, d))
    np.testing.assert_allclose(natural_parameters(m) @ quadratic_features(points), m.log_joint(points), rtol=1e-9)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_space_may_be_moved_turned_scaled_and_mirrored(seed):
    rng = np.random.default_rng(seed)
    k, d = rng.integers(1, 6), rng.integers(1, 4)
    m, points = random_mixture(rng, k, d), rng.uniform(-6, 6, (40, d))
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    scale, shift = 10.0 ** rng.uniform(-4, 4), rng.uniform(-5, 5, d)
    moved = GaussianMixture(m.weights, scale * m.means @ turn.T + shift, scale**2 * turn @ m.covariances @ turn.T)
    there = scale * points @ turn.T + shift
    lost = np.abs(there).max() / scale * 1e-14  # rounding of the moved coordinates, in the first scale
    np.testing.assert_allclose(
        moved.log_density(there), m.log_density(points) - d * np.log(scale), rtol=1e-9, atol=1e3 * lost
    )
    np.testing.assert_allclose(moved.responsibilities(there), m.responsibilities(points), atol=1e-9 + 1e3 * lost)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_neither_the_order_of_points_nor_of_components_matters(seed):
    rng = np.random.default_rng(seed)
    m, points = random_mixture(rng, 5, 3), rng.uniform(-6, 6, (30, 3))
    rows, columns = rng.permutation(30), rng.permutation(5)
    shuffled = m.subset(columns)
    np.testing.assert_allclose(
        shuffled.responsibilities(points[rows]), m.responsibilities(points)[rows][:, columns], atol=1e-13
    )
    np.testing.assert_allclose(shuffled.log_density(points[rows]), m.log_density(points)[rows], rtol=1e-13)


def test_far_from_the_origin_no_digits_are_lost():
    rng = np.random.default_rng(0)
    m = random_mixture(rng, 4, 3)
    points = np.round(rng.uniform(-6, 6, (200, 3)) * 2**20) / 2**20  # moved by 2^19 m they stay exact
    near = GaussianMixture(m.weights, np.round(m.means * 2**20) / 2**20, m.covariances * 1e-4)  # a few centimetres
    far = GaussianMixture(near.weights, near.means + 2.0**19, near.covariances)
    np.testing.assert_array_equal(far.log_density(points + 2.0**19), near.log_density(points))


def test_responsibilities_are_shares_also_where_no_component_reaches():
    m = random_mixture(np.random.default_rng(1), 6, 3)
    for distance in (0.0, 1e3, 1e50, 1e100):
        w = m.responsibilities([[distance, -distance, distance]])
        np.testing.assert_allclose(w.sum(axis=1), 1.0, rtol=1e-12)
        assert (w >= 0).all()


def test_a_component_of_weight_zero_explains_nothing():
    m = GaussianMixture([0.0, 1.0], [[0.0], [5.0]], [[[1.0]], [[1.0]]])
    np.testing.assert_array_equal(m.responsibilities([[0.0]]), [[0.0, 1.0]])
    assert m.assign([[0.0]]) == [1]
    assert m.log_density([[0.0]]) == pytest.approx(multivariate_normal(5, 1).logpdf(0))


def test_assign_counts_the_weights_in():
    m = GaussianMixture([0.999, 0.001], [[0.0], [1.0]], [[[1.0]], [[1.0]]])
    assert m.assign([[0.6]]) == [0]  # nearer to the second


def test_samples_have_the_mixtures_moments():
    m = random_mixture(np.random.default_rng(2), 3, 2)
    n = 200_000
    s = m.sample(n, rng=3)
    mean = m.weights @ m.means
    spread = m.means - mean
    covariance = np.einsum("k,kij->ij", m.weights, m.covariances + spread[:, :, None] * spread[:, None])
    np.testing.assert_allclose(s.mean(axis=0), mean, atol=5 * np.sqrt(covariance.max() / n))
    fourth = ((s - mean) ** 4).mean(axis=0).max()
    np.testing.assert_allclose(np.cov(s.T), covariance, atol=5 * np.sqrt(fourth / n))
    share = np.bincount(m.assign(s), minlength=3) / n
    expected = m.responsibilities(s).mean(axis=0)
    assert np.abs(expected - m.weights).max() < 5 * np.sqrt(0.25 / n)
    assert share.shape == (3,)


def test_samples_one_by_one():
    m = random_mixture(np.random.default_rng(5), 4, 3)
    rng = np.random.default_rng(7)
    component, noise = rng.choice(4, size=50, p=m.weights), rng.standard_normal((50, 3))
    expected = [m.means[k] + np.linalg.cholesky(m.covariances[k]) @ z for k, z in zip(component, noise, strict=True)]
    np.testing.assert_allclose(m.sample(50, rng=7), expected, rtol=1e-12)
    np.testing.assert_array_equal(m.sample(50), m.sample(50, rng=0))


def test_the_same_seed_draws_the_same_points():
    m = random_mixture(np.random.default_rng(4), 3, 3)
    np.testing.assert_array_equal(m.sample(9, rng=7), m.sample(9, rng=7))
    np.testing.assert_array_equal(m.sample(9, rng=7), m.sample(9, np.random.default_rng(7)))
    assert (m.sample(9, rng=7) != m.sample(9, rng=8)).all()
    assert m.sample(1).shape == (1, 3)


def test_subset_keeps_the_named_components_in_the_named_order():
    m = GaussianMixture([0.1, 0.3, 0.6], [[0.0], [1.0], [2.0]], [[[1.0]], [[2.0]], [[3.0]]])
    kept = m.subset([2, 0])
    np.testing.assert_allclose(kept.weights, [6 / 7, 1 / 7])
    np.testing.assert_array_equal(kept.means, [[2.0], [0.0]])
    np.testing.assert_array_equal(kept.covariances, [[[3.0]], [[1.0]]])
    np.testing.assert_array_equal(m.subset(np.array([True, False, True])).means, [[0.0], [2.0]])
    assert m.subset(1).n_components == 1


def test_a_moved_mixture_is_that_of_the_moved_points():
    m = random_mixture(np.random.default_rng(3), 4, 2)
    points, away = np.random.default_rng(4).normal(size=(50, 2)), np.array([3.0, -40.0])
    np.testing.assert_allclose(m.moved(away).log_density(points + away), m.log_density(points), rtol=1e-9)
    for offset in (1.0, [1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]]):
        with pytest.raises(CloudError, match=r"^offset: shape \(.*\); expected \(2,\)"):
            m.moved(offset)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))], ids=["copy", "pickle"])
def test_a_copy_of_a_mixture_does_not_change_either(copied):
    m = copied(GaussianMixture(*ONE))
    with pytest.raises(ValueError, match="read-only"):
        m.means[0] = 1.0


def test_a_mixture_does_not_change_and_shares_no_memory():
    weights = np.array([0.5, 0.5])
    m = GaussianMixture(weights, [[0], [1]], [[[1]], [[1]]])
    weights[0] = 9.0
    assert m.weights[0] == 0.5
    assert {m.weights.dtype, m.means.dtype, m.covariances.dtype} == {np.dtype(np.float64)}
    with pytest.raises(ValueError, match="read-only"):
        m.means[0, 0] = 1.0
    with pytest.raises(AttributeError):
        m.weights = weights


ONE = ([1.0], [[0.0, 0.0]], [np.eye(2)])


@pytest.mark.parametrize(
    ("weights", "means", "covariances", "words"),
    [
        ([0.7], *ONE[1:], "mixture weights: from 0.7, sum 0.7; expected >= 0, sum 1"),
        ([1.0 + 1e-7], *ONE[1:], "mixture weights: from 1, sum 1.0000001; expected"),
        ([1.5, -0.5], [[0.0], [1.0]], [[[1.0]], [[1.0]]], "mixture weights: from -0.5, sum 1; expected"),
        ([np.nan], *ONE[1:], "mixture: NaN or infinity among weights, means or covariances"),
        (ONE[0], [[np.inf, 0.0]], ONE[2], "mixture: NaN or infinity among weights, means or covariances"),
        (*ONE[:2], [np.full((2, 2), np.nan)], "mixture: NaN or infinity among weights, means or covariances"),
        (*ONE[:2], [[[1.0, 2.0], [2.0, 1.0]]], "covariance of component 0: smallest eigenvalue -1, not positive"),
        (
            *ONE[:2],
            [np.zeros((2, 2))],
            "covariance of component 0: smallest eigenvalue 0, not positive definite; raise covariance_floor",
        ),
        (*ONE[:2], [[[1.0, 0.5], [0.1, 1.0]]], "covariance of component 0: not symmetric"),
        (*ONE[:2], [[[1e-9, 5e-10], [1e-10, 1e-9]]], "covariance of component 0: not symmetric"),
        ([0.5, 0.5], np.eye(2), [np.eye(2), [[1.0, 0.5], [0.1, 1.0]]], "covariance of component 1: not symmetric"),
        ([0.5, 0.5], [[0.0], [1.0]], [[[1.0]], [[-1.0]]], "covariance of component 1: "),
        (
            ONE[0],
            [0.0, 0.0],
            ONE[2],
            "mixture: weights, means, covariances of shapes (1,), (2,), (1, 2, 2); expected (K,), (K, D), (K, D, D)",
        ),
        ([0.5, 0.5], *ONE[1:], "mixture: weights, means, covariances of shapes"),
        (*ONE[:2], np.eye(2), "mixture: weights, means, covariances of shapes"),
        ([], np.empty((0, 2)), np.empty((0, 2, 2)), "mixture: weights, means, covariances of shapes"),
        (["heavy"], *ONE[1:], "mixture weights: not an array of numbers"),
        (ONE[0], [[0.0], [0.0, 1.0]], ONE[2], "mixture means: not an array of numbers"),
        (*ONE[:2], None, "mixture"),
    ],
)
def test_what_is_no_mixture_is_refused(weights, means, covariances, words):
    with pytest.raises(CloudError, match="^" + re.escape(words)):
        GaussianMixture(weights, means, covariances)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0.0, 0.0, 0.0]], "points: shape (1, 3); expected (N, D) with D = 2"),
        ([0.0, 0.0], "points: shape (2,)"),
        (np.empty((0, 2)), "points: 0 points; at least 1 needed"),
        ([[0.0, np.nan]], "points: 1 of 1 points hold NaN or infinity"),
        ([["a", "b"]], "points: not an array of numbers"),
        ([[1e200, 0.0]], "points: coordinates beyond 1e+100 m; their squares overflow"),
    ],
)
@pytest.mark.parametrize("method", ["log_joint", "log_density", "responsibilities", "assign", "log_likelihood"])
def test_points_that_do_not_fit_are_refused(method, points, words):
    with pytest.raises(CloudError, match="^" + re.escape(words)):
        getattr(GaussianMixture(*ONE), method)(points)


@pytest.mark.parametrize("indices", [[], [False, False], [0]])
def test_a_subset_without_weight_is_refused(indices):
    m = GaussianMixture([0.0, 1.0], [[0.0], [1.0]], [[[1.0]], [[1.0]]])
    with pytest.raises(CloudError, match=r"^mixture subset: no component of positive weight left; keep at least one"):
        m.subset(indices)


@pytest.mark.parametrize("indices", [[7], [0.5], [True, True, True]])
def test_a_subset_of_what_is_not_there_is_refused(indices):
    with pytest.raises(CloudError, match="mixture subset: expected integers from 0 to 0"):
        GaussianMixture(*ONE).subset(indices)


@pytest.mark.parametrize("n", [0, -3, 2.5, "two"])
def test_a_number_of_samples_below_one_is_refused(n):
    with pytest.raises(ValueError, match=r"n = .*; expected a whole number of at least 1"):
        GaussianMixture(*ONE).sample(n)


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_cholesky_factors_are_lower_triangles_whose_squares_are_the_covariances(seed):
    m = random_mixture(np.random.default_rng(seed), 4, 3)
    factors = cholesky_factors(m.covariances)
    np.testing.assert_allclose(factors @ factors.swapaxes(1, 2), m.covariances, rtol=1e-12, atol=1e-12)
    assert (np.triu(factors, 1) == 0).all()


def test_an_offset_that_is_no_array_is_named():
    with pytest.raises(CloudError, match=r"^offset: "):
        GaussianMixture([1.0], [[0.0]], [[[1.0]]]).moved("far")


def test_covariances_of_rounded_symmetry_are_taken_and_others_named():
    nearly = np.array([[[1.0, 0.1 + 1e-12], [0.1, 1.0]]])
    assert GaussianMixture([1.0], [[0.0, 0.0]], nearly).n_components == 1
    with pytest.raises(CloudError, match=r"^covariance of component 1: not symmetric$"):
        GaussianMixture([0.5, 0.5], np.zeros((2, 2)), [np.eye(2), [[1.0, 0.2], [0.1, 1.0]]])
