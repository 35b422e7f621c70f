"""The two filters against PCL's published counts, loops that spell the rules out, and what theory says of them."""

from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gmmcd_teach import filtering
from gmmcd_teach.clouds import CloudError, read_cloud
from gmmcd_teach.filtering import statistical_outlier_mask, voxel_downsample

FILTERS = Path(__file__).parents[2] / "shared/real/filters"
PUBLISHED = [
    ("bun0.pcd", 0.02, 352, 103),
    ("table_scene_mug_stereo_textured_noplane.pcd", 0.01, 22745, 719),
]
quick = settings(max_examples=40, deadline=None)
needs_files = pytest.mark.skipif(not FILTERS.is_dir(), reason="needs ../shared/real/filters")


def clouds(low=-50, high=50, max_size=60):
    """Points of D = 2 or 3 on a lattice of 1/8, so that many coincide and sums of them are exact."""
    shapes = st.tuples(st.integers(1, max_size), st.integers(2, 3))
    return hnp.arrays(np.float64, shapes, elements=st.integers(8 * low, 8 * high).map(lambda i: i / 8))


def outlier_mask_by_loops(points, n_neighbors, std_ratio):
    mean_distances = []
    for i, point in enumerate(points):
        others = sorted(np.sqrt(((point - q) ** 2).sum()) for j, q in enumerate(points) if j != i)
        mean_distances.append(sum(others[:n_neighbors]) / n_neighbors)
    mean = sum(mean_distances) / len(points)
    variance = sum((d - mean) ** 2 for d in mean_distances) / (len(points) - 1)
    return np.array(mean_distances), mean + std_ratio * variance**0.5


def voxels_by_loops(points, leaf):
    members = defaultdict(list)
    for i, point in enumerate(points):
        members[tuple(int(np.floor(x / leaf)) for x in point)].append(i)
    return [members[cell] for cell in sorted(members)]


@needs_files
@pytest.mark.parametrize(("name", "leaf", "kept", "occupied"), PUBLISHED)
def test_published_counts_of_pcl(name, leaf, kept, occupied):
    points = read_cloud(FILTERS / name)
    assert statistical_outlier_mask(points, 50, 1.0).sum() == kept
    assert len(voxel_downsample(points, leaf).counts) == occupied
    assert statistical_outlier_mask(points.astype(np.float32)).sum() == kept
    assert len(voxel_downsample(points.astype(np.float32), leaf).counts) == occupied


@needs_files
@pytest.mark.parametrize(("name", "leaf", "kept", "occupied"), PUBLISHED)
def test_float32_arithmetic_as_in_pcl_gives_the_same_count(name, leaf, kept, occupied):
    points = read_cloud(FILTERS / name).astype(np.float32)
    cells = np.floor(points * (np.float32(1) / np.float32(leaf)))
    assert len(np.unique(cells, axis=0)) == occupied


@quick
@given(clouds(max_size=25), st.integers(1, 6), st.floats(0, 3))
def test_outliers_as_spelled_out(points, n_neighbors, std_ratio):
    if len(points) <= n_neighbors:
        with pytest.raises(CloudError, match=f"n_neighbors = {n_neighbors} others need {n_neighbors + 1}$"):
            statistical_outlier_mask(points, n_neighbors, std_ratio)
        return
    distances, threshold = outlier_mask_by_loops(points, n_neighbors, std_ratio)
    sure = np.abs(distances - threshold) > 1e-9
    mask = statistical_outlier_mask(points, n_neighbors, std_ratio)
    assert mask.dtype == bool
    np.testing.assert_array_equal(mask[sure], (distances <= threshold)[sure])


@quick
@given(clouds(), st.sampled_from([0.125, 0.3, 1, 7.5, 1000]))
def test_voxels_as_spelled_out(points, leaf):
    voxels = voxel_downsample(points, leaf)
    members = voxels_by_loops(points, leaf)
    assert voxels.counts.tolist() == [len(ids) for ids in members]
    assert [np.flatnonzero(voxels.membership == m).tolist() for m in range(len(members))] == members
    np.testing.assert_allclose(voxels.centroids, [points[ids].mean(axis=0) for ids in members], rtol=0, atol=1e-12)


@quick
@given(clouds(), st.integers(-(10**6), 10**6))
def test_moving_by_whole_leaves_moves_the_centroids(points, leaves):
    here, there = voxel_downsample(points, 0.5), voxel_downsample(points + 0.5 * leaves, 0.5)
    np.testing.assert_array_equal(there.membership, here.membership)
    np.testing.assert_allclose(there.centroids, here.centroids + 0.5 * leaves, rtol=0, atol=1e-9)


@quick
@given(clouds(), st.randoms(use_true_random=False))
def test_order_of_points_does_not_matter(points, random):
    order = np.array(random.sample(range(len(points)), len(points)))
    here, there = voxel_downsample(points, 0.5), voxel_downsample(points[order], 0.5)
    np.testing.assert_array_equal(there.membership, here.membership[order])
    np.testing.assert_allclose(there.centroids, here.centroids, rtol=0, atol=1e-12)


@quick
@given(clouds())
def test_downsampling_keeps_the_mean_and_its_own_result(points):
    voxels = voxel_downsample(points, 0.5)
    np.testing.assert_allclose(voxels.counts @ voxels.centroids / len(points), points.mean(axis=0), atol=1e-12)
    again = voxel_downsample(voxels.centroids, 0.5)
    np.testing.assert_allclose(again.centroids, voxels.centroids, rtol=0, atol=0)


@pytest.mark.parametrize("far", [0.0, 5e5, 5.4e6])
def test_outliers_and_voxels_far_from_the_origin(far):
    points = np.random.default_rng(0).integers(0, 4096, (3000, 3)) / 1024  # exact at 500 km too
    points[:5] = 10 * np.arange(1, 6)[:, None]
    near = statistical_outlier_mask(points, 10)
    assert not near[:5].any()
    np.testing.assert_array_equal(statistical_outlier_mask(points + far, 10), near)
    voxels = voxel_downsample(points + far, 0.25)
    np.testing.assert_allclose(voxels.centroids - far, voxel_downsample(points, 0.25).centroids, rtol=0, atol=1e-8)


@pytest.mark.parametrize("scale", [1e-3, 1000.0])
@pytest.mark.parametrize("turn", [False, True])
def test_outliers_do_not_depend_on_unit_or_attitude(scale, turn):
    rng = np.random.default_rng(1)
    points = np.vstack([rng.normal(size=(500, 3)), rng.uniform(-9, 9, (20, 3))])
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0] if turn else np.eye(3)
    mask = statistical_outlier_mask(points, 20)
    assert 0 < mask.sum() < len(mask)
    np.testing.assert_array_equal(statistical_outlier_mask(scale * points @ rotation.T, 20), mask)


def test_a_point_is_left_out_of_its_own_neighbours_among_duplicates():
    points = np.repeat([[0.0, 0, 0], [1, 0, 0], [0, 5, 0]], [60, 60, 2], axis=0)
    distances, threshold = outlier_mask_by_loops(points, 50, 1.0)
    assert (distances[:120] == 0).all()
    np.testing.assert_array_equal(statistical_outlier_mask(points), distances <= threshold)
    assert statistical_outlier_mask(np.ones((100, 3))).all()


@pytest.mark.parametrize(("together", "kept"), [(51, True), (50, False)])
def test_50_neighbours_and_one_standard_deviation_where_nothing_else_is_asked_for(together, kept):
    """Each of 51 points on one place has 50 neighbours at hand; of 50 it has one far away, 1.7 deviations too far."""
    points = np.repeat([[0.0, 0, 0], [9, 0, 0]], [together, 150], axis=0)
    np.testing.assert_array_equal(statistical_outlier_mask(points), [kept] * together + [True] * 150)


@pytest.mark.parametrize("cells", [1, 10**9])
def test_numbering_by_table_and_by_sorting_agree(monkeypatch, cells):
    points = np.random.default_rng(2).normal(size=(2000, 3))
    expected = voxels_by_loops(points, 0.1)
    monkeypatch.setattr(filtering, "TABLE_CELLS", cells)
    monkeypatch.setattr(filtering, "TABLE_SPARSITY", cells)
    assert voxel_downsample(points, 0.1).counts.tolist() == [len(ids) for ids in expected]


def test_one_point_two_points_and_one_very_far():
    one = voxel_downsample([[-0.3, 0.2, 7.0]], 0.1)
    np.testing.assert_array_equal(one.centroids, [[-0.3, 0.2, 7.0]])
    np.testing.assert_array_equal(statistical_outlier_mask([[0, 0], [1, 1]], 1), [True, True])
    far = np.vstack([np.random.default_rng(0).uniform(size=(100, 3)), [[1e12, -1e12, 1e12]]])
    assert statistical_outlier_mask(far, 50).tolist() == [True] * 100 + [False]


@pytest.mark.parametrize("far", [[1e12, 1e12, 1e12], [1e6, 1e6, 1e6], [1e12, 1e12, 0.0]], ids=str)
def test_more_cells_than_a_64_bit_number_can_name_are_numbered_in_order(far):
    points = np.vstack([np.random.default_rng(0).uniform(size=(100, 3)) * [1, 1, 0.02], [far], np.negative([far])])
    voxels, members = voxel_downsample(points, 0.01), voxels_by_loops(points, 0.01)
    assert [np.flatnonzero(voxels.membership == m).tolist() for m in range(len(members))] == members


@pytest.mark.parametrize(
    ("widest", "fit"),
    [([2**31 - 1, 2**31 - 1], False), ([2**31 - 1025, 2**31 - 1], True), ([2**62 - 1024], True), ([2**62], False)],
)
def test_a_key_names_fewer_than_2_to_the_62_cells(widest, fit):
    cells = np.array([np.zeros(len(widest)), widest]).T
    assert filtering._fit_in_a_key(cells) is fit


def test_a_cell_number_of_exactly_2_to_the_53_is_too_large():
    assert len(voxel_downsample([[0.0], [2.0**53 - 1]], 1.0).counts) == 2
    with pytest.raises(CloudError, match=r"^points: reach too far"):
        voxel_downsample([[0.0], [2.0**53]], 1.0)


def test_a_million_duplicates():
    points = np.tile([[0.1, 0.2, 0.3]], (1_000_000, 1))
    voxels = voxel_downsample(points, 0.05)
    np.testing.assert_array_equal(voxels.centroids, [[0.1, 0.2, 0.3]])
    assert voxels.counts.tolist() == [1_000_000]


def test_nothing_is_changed_and_result_is_frozen():
    points = np.random.default_rng(0).normal(size=(100, 3))
    copy = points.copy()
    voxels = voxel_downsample(points, 0.5)
    statistical_outlier_mask(points)
    np.testing.assert_array_equal(points, copy)
    with pytest.raises(AttributeError):
        voxels.counts = None


@pytest.mark.parametrize("leaf", [0, -0.1, np.nan, np.inf, "0.1", None, [0.1, 0.1, 0.1]])
def test_bad_leaf(leaf):
    with pytest.raises(ValueError, match=r"leaf_size is .*; expected a length in metres above 0"):
        voxel_downsample(np.ones((3, 3)), leaf)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("leaf", [1e-300, 5e-324, 1e-17, 1e-6])
def test_leaf_too_small_for_the_cloud(leaf, side):
    points = np.array([[1.0, 2, 3], [side * 1e10, 0, 0]])  # 10^16 micrometres are more than 2^53
    assert len(voxel_downsample(points, 2e-6).counts) == 2
    with pytest.raises(CloudError, match=f"^points: reach too far for cells of {leaf} m; expected a larger leaf"):
        voxel_downsample(points, leaf)


@pytest.mark.parametrize("n_neighbors", [0, -1, 2.5, "5", None])
def test_bad_number_of_neighbours(n_neighbors):
    with pytest.raises(ValueError, match="n_neighbors is"):
        statistical_outlier_mask(np.random.default_rng(0).normal(size=(99, 3)), n_neighbors)


@pytest.mark.parametrize("std_ratio", [-0.1, np.nan, np.inf, "1", None])
def test_bad_ratio(std_ratio):
    with pytest.raises(ValueError, match="std_ratio is"):
        statistical_outlier_mask(np.random.default_rng(0).normal(size=(99, 3)), 5, std_ratio)


@pytest.mark.parametrize("points", [[], [1, 2, 3], [[1, np.nan, 0]] * 60, "cloud"])
def test_unfit_clouds(points):
    with pytest.raises(CloudError, match=r"^points: "):
        statistical_outlier_mask(points)
    with pytest.raises(CloudError, match=r"^points: "):
        voxel_downsample(points, 0.1)


def test_cells_far_apart_in_many_dimensions_stay_apart_and_in_order():
    rng = np.random.default_rng(0)
    points = rng.integers(-(10**6), 10**6, (20_000, 5)) + 0.5  # metres: ranks alone would need 2^71 numbers
    points = np.unique(points, axis=0)
    voxels = voxel_downsample(rng.permutation(points), 1.0)
    np.testing.assert_array_equal(voxels.centroids, points)
    assert (voxels.counts == 1).all()
