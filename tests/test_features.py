"""Quadratic features in blocks of neighbours, and which components are out of a block's reach."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gmmcd_teach import CloudError, GaussianMixture, batch, componentwise
from gmmcd_teach.features import average_over_cells, blocks_of, dimensions, neighbourhoods, quadratic_features

SEEDS = st.integers(0, 2**32 - 1)
few = settings(deadline=None, max_examples=25)


def scattered(seed: int, n: int, d: int) -> np.ndarray:
    """(n, d) points in clumps of quite different size, far apart."""
    rng = np.random.default_rng(seed)
    return (
        10.0 ** rng.uniform(-2, 1, (n, 1)) * rng.normal(size=(n, d))
        + rng.uniform(-20, 20, (4, d))[rng.integers(0, 4, n)]
    )


def mixture_on(points: np.ndarray, seed: int, k: int = 5) -> GaussianMixture:
    rng = np.random.default_rng(seed)
    d = points.shape[1]
    shape = rng.normal(size=(k, d, d)) * 10.0 ** rng.uniform(-2, 0.5, (k, 1, 1))
    covariances = shape @ shape.swapaxes(1, 2) + 1e-4 * np.eye(d)
    return GaussianMixture(rng.dirichlet(np.ones(k)), points[rng.choice(len(points), k)], covariances)


@given(SEEDS, st.integers(1, 300), st.integers(1, 3), st.integers(3, 60))
@few
def test_blocks_hold_each_point_once(seed, n, d, size):
    points, counts = scattered(seed, n, d), np.random.default_rng(seed).uniform(0, 3, n)
    blocks = blocks_of(quadratic_features(points), counts, size)
    assert blocks.features.shape[::2] == blocks.counts.shape
    assert blocks.counts.shape[1] <= size
    flat = np.hstack([*blocks.features])
    kept = blocks.counts.ravel() > 0
    expected = np.vstack([quadratic_features(points), counts])[:, counts > 0]
    found = np.vstack([flat[:-1], blocks.counts.ravel()])[:, kept]
    order, other = (np.lexsort(columns) for columns in (expected, found))
    np.testing.assert_array_equal(found[:, other], expected[:, order])


@given(SEEDS, st.integers(1, 3))
@few
def test_boxes_hold_their_points_and_no_more(seed, d):
    blocks = blocks_of(quadratic_features(scattered(seed, 200, d)), np.ones(200), 30)
    points = blocks.features[:, 1 : 1 + d]  # (M, D, B)
    edges = (points - blocks.centres[:, :, None]) / np.maximum(blocks.reaches, 1e-12)[:, :, None]
    np.testing.assert_allclose([edges.min(axis=2), edges.max(axis=2)], [-np.ones((8, d)), np.ones((8, d))])


def test_halves_lie_on_two_sides_of_the_longest_edge():
    points = np.random.default_rng(0).uniform(0, [1, 5, 2], (64, 3)).T
    left, right = neighbourhoods(points, 1)
    assert points[1, left].max() <= points[1, right].min()
    quarters = neighbourhoods(points, 2)
    assert quarters.shape == (4, 16)
    assert sorted(quarters.ravel()) == list(range(64))
    assert points[1, quarters[:2]].max() <= points[1, quarters[2:]].min()


@pytest.mark.parametrize("d", [1, 2, 3, 7])
def test_dimensions_from_the_number_of_features(d):
    assert dimensions(len(quadratic_features(np.zeros((1, d))))) == d


@given(SEEDS, st.integers(1, 3))
@few
def test_what_is_out_of_reach_has_no_share(seed, d):
    """The bound against the largest log-density in the block, by looking at every point."""
    points = scattered(seed, 300, d)
    m = mixture_on(points, seed)
    blocks = blocks_of(quadratic_features(points), np.ones(300), 40)
    batch.expect(m, blocks)
    here = blocks.features[:, 1 : 1 + d].swapaxes(1, 2)  # (M, B, D)
    for block, near in zip(here, batch.within_reach(m, blocks), strict=True):
        joint, least = m.log_joint(block), m.log_density(block).min()
        left_out = np.setdiff1d(np.arange(m.n_components), near)
        assert (joint[left_out] < least - batch.REACH + 1e-6).all()


def test_a_component_in_the_box_is_in_reach_and_one_beyond_is_not():
    points = np.concatenate([np.zeros((10, 1)), np.ones((10, 1))])
    m = GaussianMixture([0.5, 0.5], [[0.0], [1.0]], [[[1 / 60]], [[0.01]]])  # 30 and 50 nats from one to the other
    blocks = blocks_of(quadratic_features(points), np.ones(20), 10)
    batch.expect(m, blocks)
    assert [near.tolist() for near in batch.within_reach(m, blocks)] == [[0], [0, 1]]
    assert [near.tolist() for near in batch.within_reach(m, blocks, np.inf)] == [[0, 1], [0, 1]]


@given(SEEDS, st.integers(1, 3))
@few
def test_leaving_out_changes_nothing(seed, d):
    points = scattered(seed, 300, d)
    counts = np.random.default_rng(seed).uniform(0, 2, 300)
    phi = quadratic_features(points)
    blocks = blocks_of(phi, counts, 40)
    for m in (mixture_on(points, seed), mixture_on(points, seed + 1)):
        log_likelihood, sums = batch.expect(m, blocks)
        assert log_likelihood == pytest.approx(counts @ m.log_density(points), rel=1e-10)
        expected = (counts[:, None] * m.responsibilities(points)).T @ phi.T
        np.testing.assert_allclose(sums, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
        assert componentwise.expect(m, blocks)[0] == pytest.approx(log_likelihood, rel=1e-10)


@pytest.mark.parametrize("bits", [54, 58, 62, 70, 1000])
def test_cells_too_many_to_count_are_refused(bits):
    points = np.array([[0.0], [0.3], [1.0]])
    with pytest.raises(CloudError, match="too many cells"):
        average_over_cells(points, quadratic_features(points), np.ones(3), 2.0**-bits)
    assert average_over_cells(points, quadratic_features(points), np.ones(3), 2.0**-52)[0].shape == (3, 3)
