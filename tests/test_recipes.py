"""The recipes of chapter 18: to and from other libraries, and the estimator among those of scikit-learn."""

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.mixture import BayesianGaussianMixture, GaussianMixture
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from gmmcd_teach import CloudError, MDLGaussianMixture, fit_mixture, read_cloud, read_fields, write_cloud
from gmmcd_teach import GaussianMixture as Mixture
from gmmcd_teach.formats.mixtures import read_mixture, write_mixture
from gmmcd_teach.recipes import (
    from_open3d,
    from_pointcloud2,
    from_pyvista,
    points_of,
    to_open3d,
    to_pointcloud2,
    to_pyvista,
)

POINTS = np.random.default_rng(0).uniform(-3, 5, (40, 3))
HOLED = np.vstack([POINTS, [np.nan, 0, 0], [0, np.inf, 0]])


def test_open3d_there_and_back():
    open3d = pytest.importorskip("open3d")
    np.testing.assert_array_equal(from_open3d(to_open3d(POINTS)), POINTS)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(HOLED))
    np.testing.assert_array_equal(from_open3d(cloud), POINTS)


@pytest.mark.parametrize("name", ["a.ply", "a.pcd", "a.xyz"])
@pytest.mark.parametrize("options", [{}, {"write_ascii": True}, {"compressed": True}], ids=str)
def test_files_of_open3d_are_read_and_ours_by_open3d(tmp_path, name, options):
    open3d = pytest.importorskip("open3d")
    open3d.io.write_point_cloud(str(tmp_path / name), to_open3d(POINTS), **options)
    np.testing.assert_allclose(read_cloud(tmp_path / name), POINTS, rtol=0, atol=1e-5)
    write_cloud(tmp_path / name, POINTS)
    np.testing.assert_allclose(from_open3d(open3d.io.read_point_cloud(str(tmp_path / name))), POINTS, rtol=0, atol=1e-5)


def test_pyvista_there_and_back(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    cloud = to_pyvista(POINTS, appeared=POINTS[:, 0] > 0)
    np.testing.assert_array_equal(from_pyvista(cloud), POINTS)
    np.testing.assert_array_equal(cloud["appeared"], POINTS[:, 0] > 0)
    cloud.save(tmp_path / "a.ply")
    np.testing.assert_allclose(read_cloud(tmp_path / "a.ply"), POINTS, rtol=0, atol=1e-5)
    write_cloud(tmp_path / "b.ply", POINTS)
    np.testing.assert_allclose(from_pyvista(pyvista.read(tmp_path / "b.ply")), POINTS, rtol=0, atol=1e-5)


def pointcloud2(order, n_rows=2, n_columns=3, padding=5):
    """A message made byte by byte: gaps between fields, padding after rows, a field of two numbers."""
    rng = np.random.default_rng(3)
    data, expected = b"", []
    for _ in range(n_rows):
        for _ in range(n_columns):
            x, y, z, a, b = rng.uniform(-1, 1, 5)
            ring = int(rng.integers(0, 9999))
            data += struct.pack(f"{order}fff4xH2xdd", x, y, z, ring, a, b)
            expected.append((x, y, z, ring, a, b))
        data += b"\xff" * padding
    step = struct.calcsize(f"{order}fff4xH2xdd")
    fields = [SimpleNamespace(name=axis, offset=4 * i, datatype=7, count=1) for i, axis in enumerate("xyz")]
    fields += [SimpleNamespace(name="ring", offset=16, datatype=4, count=1)]
    fields += [SimpleNamespace(name="pair", offset=20, datatype=8, count=2)]
    message = SimpleNamespace(
        height=n_rows, width=n_columns, fields=fields, is_bigendian=order == ">", point_step=step,
        row_step=n_columns * step + padding, data=data, is_dense=True,
    )  # fmt: skip
    return message, np.array(expected)


@pytest.mark.parametrize("order", ["<", ">"])
def test_pointcloud2_byte_by_byte(order):
    message, expected = pointcloud2(order)
    columns = from_pointcloud2(message)
    np.testing.assert_allclose(points_of(columns), expected[:, :3], rtol=1e-6)
    np.testing.assert_array_equal(columns["ring"], expected[:, 3])
    np.testing.assert_array_equal(columns["pair"], expected[:, 4:])


def test_pointcloud2_there_and_back():
    label = np.arange(40, dtype=np.int32)
    columns = from_pointcloud2(to_pointcloud2(POINTS, label=label, weight=POINTS[:, 1]))
    np.testing.assert_allclose(points_of(columns), POINTS, rtol=1e-6)
    np.testing.assert_array_equal(columns["label"], label)
    np.testing.assert_array_equal(columns["weight"], POINTS[:, 1])


@pytest.mark.parametrize("column", [np.arange(40), np.ones(39, np.float32), np.array(["a"] * 40)], ids=str)
def test_columns_that_a_pointcloud2_cannot_hold(column):
    with pytest.raises(CloudError, match=r"column 'label': .* expected 40 numbers of i1 u1"):
        to_pointcloud2(POINTS, label=column)


def test_pointcloud2_of_a_bag():
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    types = {name.rpartition("/")[2]: kind for name, kind in store.types.items() if name.split("/")[0] != "rosbags"}
    ours = vars(to_pointcloud2(POINTS, label=np.arange(40, dtype=np.uint16)))
    fields = [types["PointField"](**vars(field)) for field in ours.pop("fields")]
    header = types["Header"](stamp=types["Time"](sec=1, nanosec=2), frame_id="map")
    packed = store.serialize_cdr(
        types["PointCloud2"](header=header, fields=fields, **ours), "sensor_msgs/msg/PointCloud2"
    )
    columns = from_pointcloud2(store.deserialize_cdr(packed, "sensor_msgs/msg/PointCloud2"))
    np.testing.assert_allclose(points_of(columns), POINTS, rtol=1e-6)
    np.testing.assert_array_equal(columns["label"], np.arange(40))


def test_a_mixture_comes_back_whole_from_an_npz(tmp_path):
    mixture = fit_mixture(POINTS, max_components=3).mixture
    write_mixture(tmp_path / "m.npz", mixture)
    back = read_mixture(tmp_path / "m.npz")
    np.testing.assert_array_equal(back.log_density(POINTS), mixture.log_density(POINTS))
    with np.load(tmp_path / "m.npz", allow_pickle=False) as arrays:  # with NumPy alone, too
        again = Mixture(arrays["weights"], arrays["means"], arrays["covariances"])
    np.testing.assert_array_equal(again.responsibilities(POINTS), mixture.responsibilities(POINTS))


def test_a_mixture_works_as_one_of_scikit_learn():
    mixture = fit_mixture(POINTS, max_components=3).mixture
    theirs = GaussianMixture(mixture.n_components)
    theirs.weights_, theirs.means_, theirs.covariances_ = mixture.weights, mixture.means, mixture.covariances
    theirs.precisions_cholesky_ = np.linalg.cholesky(np.linalg.inv(mixture.covariances))
    np.testing.assert_allclose(theirs.score_samples(POINTS), mixture.log_density(POINTS), rtol=1e-9)


# --- the estimator among others ------------------------------------------------------------------------------------


def two_groups(n=400, seed=0):
    return np.random.default_rng(seed).normal(np.repeat([[0.0, 0.0], [10.0, 0.0]], n, axis=0))


def test_in_a_pipeline():
    pipeline = make_pipeline(StandardScaler(), MDLGaussianMixture(8, tol=1e-4, update="componentwise", random_state=0))
    labels = pipeline.fit_predict(two_groups())
    assert pipeline[-1].n_components_ == 2
    assert len(set(labels[:400])) == len(set(labels[400:])) == 1


def test_in_a_grid_search():
    grid = {"covariance_floor": [1e-6, 25.0], "update": ["batch", "componentwise"]}
    search = GridSearchCV(MDLGaussianMixture(8, tol=1e-4, random_state=0), grid, cv=3).fit(two_groups())
    assert search.best_params_["covariance_floor"] == 1e-6
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()
    assert search.best_estimator_.n_components_ == 2


def test_scikit_learn_keeps_what_it_is_told_and_ours_chooses():
    X = two_groups()
    ours = MDLGaussianMixture(8, tol=1e-4, update="componentwise", random_state=0).fit(X)
    bayes = BayesianGaussianMixture(n_components=8, random_state=0, max_iter=500).fit(X)
    assert ours.n_components_ == 2
    assert len(bayes.weights_) == 8
    assert ours.score(X) > GaussianMixture(1).fit(X).score(X)


def test_changed_points_keep_their_columns(tmp_path):
    write_cloud(tmp_path / "a.ply", POINTS, appeared=POINTS[:, 0] > 0)
    np.testing.assert_array_equal(read_fields(tmp_path / "a.ply")["appeared"], POINTS[:, 0] > 0)
