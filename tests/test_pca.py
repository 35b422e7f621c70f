"""Principal axes against scikit-learn, and against what theory says of moved, turned and scaled clouds."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.decomposition import PCA

from gmmcd_teach import CloudError, principal_axes

SEEDS = st.integers(0, 2**32 - 1)
quick = settings(max_examples=30, deadline=None)


def stretched(seed: int, n: int = 60, d: int = 3) -> np.ndarray:
    """A cloud whose variances along its axes are far enough apart that the axes are well determined."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    return rng.normal(size=(n, d)) * 4.0 ** np.arange(d) @ turn + rng.uniform(-3, 3, d)


@given(SEEDS, st.integers(1, 4))
@quick
def test_axes_variances_and_scores_are_scikit_learns(seed, d):
    points = stretched(seed, d=d)
    axes, twin = principal_axes(points), PCA().fit(points)
    np.testing.assert_allclose(axes.mean, twin.mean_, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(axes.variances, twin.explained_variance_, rtol=1e-10)
    signs = np.sign((axes.axes * twin.components_).sum(axis=1))
    np.testing.assert_allclose(axes.axes, signs[:, None] * twin.components_, atol=1e-9)
    for k in range(1, d + 1):
        scores = axes.project(points, k)
        assert scores.shape == (60, k)
        np.testing.assert_allclose(scores, signs[:k] * twin.transform(points)[:, :k], atol=1e-8)


@given(SEEDS, st.integers(1, 4))
@quick
def test_axes_are_orthonormal_ordered_and_of_one_sign(seed, d):
    points = stretched(seed, d=d)
    axes = principal_axes(points)
    np.testing.assert_allclose(axes.axes @ axes.axes.T, np.eye(d), atol=1e-12)
    assert (np.diff(axes.variances) <= 0).all()
    assert (axes.axes[np.arange(d), abs(axes.axes).argmax(axis=1)] > 0).all()
    np.testing.assert_allclose(axes.project(points, d).var(axis=0, ddof=1), axes.variances, rtol=1e-9)


@given(SEEDS)
@quick
def test_all_axes_give_the_points_back_and_fewer_the_nearest_plane(seed):
    points = stretched(seed)
    axes = principal_axes(points)
    np.testing.assert_allclose(axes.reconstruct(axes.project(points, 3)), points, rtol=1e-12, atol=1e-11)
    for k in (1, 2):
        lost = points - axes.reconstruct(axes.project(points, k))
        assert (lost**2).sum() == pytest.approx(59 * axes.variances[k:].sum(), rel=1e-9)
        np.testing.assert_allclose(lost @ axes.axes[:k].T, 0, atol=1e-10)


@given(SEEDS, st.floats(-3, 3))
@quick
def test_the_axes_turn_with_the_cloud(seed, scale):
    rng = np.random.default_rng(seed)
    points, turn = stretched(seed), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    here = principal_axes(points)
    there = principal_axes(10**scale * rng.permutation(points) @ turn.T + rng.uniform(-5, 5, 3))
    np.testing.assert_allclose(there.variances, 100**scale * here.variances, rtol=1e-9 + 1e-13 / 100 ** min(scale, 0))
    np.testing.assert_allclose(abs((there.axes * (here.axes @ turn.T)).sum(axis=1)), 1, atol=1e-7)


def test_500_km_away_the_axes_are_the_same():
    points = np.round(stretched(0) * 2**20) / 2**20
    here, there = principal_axes(points), principal_axes(points + 2.0**19)
    np.testing.assert_allclose(there.variances, here.variances, rtol=1e-8)
    np.testing.assert_allclose(there.axes, here.axes, atol=1e-8)


def test_the_axis_of_no_variance_is_the_normal_of_the_plane():
    """P13: the direction that is dropped is that of least variance, not z."""
    normal = np.array([1.0, 2.0, -2.0]) / 3
    points = np.random.default_rng(0).normal(size=(50, 3))
    points -= np.outer(points @ normal, normal)
    axes = principal_axes(points)
    assert abs(axes.axes[2] @ normal) == pytest.approx(1, abs=1e-9)
    assert 0 <= axes.variances[2] < 1e-15
    np.testing.assert_allclose(axes.reconstruct(axes.project(points, 2)), points, atol=1e-12)


def test_identical_points_have_no_variance():
    axes = principal_axes(np.full((5, 3), 2.0))
    np.testing.assert_array_equal(axes.variances, 0)
    np.testing.assert_allclose(axes.axes @ axes.axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("n", [0, 4, -1, 1.5, 2.0, "all", None])
def test_a_number_of_axes_that_there_is_not_is_refused(n):
    with pytest.raises(ValueError, match=r"n_components = .*; expected a whole number from 1 to 3"):
        principal_axes(stretched(0)).project(stretched(0), n)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[1.0, 2.0, 3.0]], "points: 1 points; at least 2 needed"),
        ([1.0, 2.0], "points: shape (2,)"),
        ([[0.0, np.nan]] * 3, "points: 3 of 3 points hold NaN"),
        ("cloud", "points: not an array of numbers"),
    ],
)
def test_what_has_no_axes_is_refused(points, words):
    with pytest.raises(CloudError, match=re.escape(words)):
        principal_axes(points)


def test_points_and_scores_of_another_dimension_are_refused():
    axes = principal_axes(stretched(0))
    with pytest.raises(CloudError, match=r"points: shape \(5, 2\); expected \(N, D\) with D = 3"):
        axes.project(np.zeros((5, 2)), 2)
    with pytest.raises(CloudError, match=r"scores: shape \(5, 4\); expected \(N, D\) with D = 1 or 2 or 3"):
        axes.reconstruct(np.zeros((5, 4)))
