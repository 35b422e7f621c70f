"""The formats that need more than their own bytes: .las and .laz through laspy, depth images with their .json."""

import builtins
import json

import numpy as np
import pytest
from PIL import Image

from gmmcd_teach import CloudError, DepthFrame, read_cloud, read_fields, simulate_pair, write_cloud
from gmmcd_teach.formats.depth import read_depth, write_depth

POINTS = np.random.default_rng(0).uniform(-3, 5, (50, 3))
GREY = np.array([[1000, 0, 2500], [1, 65535, 700]], dtype=np.uint16)
PINHOLE = {"intrinsics": [200.0, 190.0, 1.1, 0.4], "scale": 0.002}


@pytest.fixture
def laspy():
    return pytest.importorskip("laspy")


@pytest.mark.parametrize("suffix", [".las", ".laz"])
class TestLas:
    def test_round_trip_with_columns(self, laspy, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        far = POINTS + np.array([500_000.0, 4_000_000.0, 100.0])
        write_cloud(path, far, label=np.arange(50), weight=POINTS[:, 0].astype(np.float32))
        np.testing.assert_allclose(read_cloud(path), far, rtol=0, atol=6e-6)
        fields = read_fields(path)
        np.testing.assert_array_equal(fields["label"], np.arange(50))
        np.testing.assert_array_equal(fields["weight"], POINTS[:, 0].astype(np.float32))

    @pytest.mark.parametrize(("version", "point_format"), [("1.2", 3), ("1.4", 6)])
    def test_files_of_laspy_are_read(self, laspy, tmp_path, suffix, version, point_format):
        header = laspy.LasHeader(version=version, point_format=point_format)
        header.offsets, header.scales = [1, 2, 3], [0.001] * 3
        las = laspy.LasData(header)
        las.x, las.y, las.z = POINTS.T
        las.intensity = np.arange(50)
        las.write(str(tmp_path / f"a{suffix}"))
        np.testing.assert_allclose(read_cloud(tmp_path / f"a{suffix}"), POINTS, rtol=0, atol=5.1e-4)
        np.testing.assert_array_equal(read_fields(tmp_path / f"a{suffix}")["intensity"], np.arange(50))

    def test_points_far_apart_are_written_in_wider_steps_or_refused(self, laspy, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        for length in (21_470.0, 21_480.0, 1e6):
            corners = length * np.array([[0, 0, 0], [1, 1, 1], [0.3, 0.7, 1]])
            write_cloud(path, corners - length / 3)
            np.testing.assert_allclose(read_cloud(path), corners - length / 3, rtol=0, atol=length / 2**31 + 6e-6)
        with pytest.raises(CloudError, match=rf"a\{suffix}: the points lie inf m apart"):
            write_cloud(path, [[-1.7e308, 0, 0], [1.7e308, 0, 0]])

    def test_damaged_files_are_refused(self, laspy, tmp_path, suffix):
        path = tmp_path / f"a{suffix}"
        write_cloud(path, POINTS)
        whole = path.read_bytes()
        for length in (3, 100, 300, len(whole) - 30):
            path.write_bytes(whole[:length])
            with pytest.raises(CloudError, match=rf"a\{suffix}"):
                read_cloud(path)
        greedy = bytearray(whole)
        greedy[247:255] = (10**15).to_bytes(8, "little")
        path.write_bytes(greedy)
        with pytest.raises(CloudError, match="truncated"):
            read_cloud(path)

    def test_a_column_with_the_name_of_a_dimension_is_refused(self, laspy, tmp_path, suffix):
        with pytest.raises(CloudError, match="'intensity' has a meaning of its own"):
            write_cloud(tmp_path / f"a{suffix}", POINTS, intensity=np.ones(50))
        assert not list(tmp_path.iterdir())

    def test_without_laspy_one_line_says_what_to_install(self, tmp_path, suffix, monkeypatch):
        genuine = builtins.__import__

        def without(name, *arguments, **options):
            if name == "laspy":
                raise ImportError(name)
            return genuine(name, *arguments, **options)

        (tmp_path / f"a{suffix}").write_bytes(b"LASF")
        monkeypatch.setattr(builtins, "__import__", without)
        with pytest.raises(CloudError, match=r'need laspy.*pip install "laspy\[lazrs\]"'):
            read_cloud(tmp_path / f"a{suffix}")


def write_pair(folder, grey=GREY, meaning=PINHOLE):
    Image.fromarray(grey).save(folder / "a.png")
    (folder / "a.json").write_text(meaning if isinstance(meaning, str) else json.dumps(meaning))
    return folder / "a.png"


def test_pixels_become_points_one_by_one(tmp_path):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [1, 2, 3]
    path = write_pair(tmp_path, meaning=PINHOLE | {"pose": pose.tolist()})
    fx, fy, cx, cy = PINHOLE["intrinsics"]
    expected = []
    for v in range(2):
        for u in range(3):
            if z := 0.002 * GREY[v, u]:
                expected.append((pose @ [(u - cx) / fx * z, (v - cy) / fy * z, z, 1])[:3])
    np.testing.assert_allclose(read_cloud(path), expected, atol=1e-12)
    assert read_fields(path)["x"].shape == (2, 3)


def test_a_depth_image_comes_back_within_half_a_step(tmp_path):
    frame = simulate_pair("cargo_bag").before_frames[0]
    write_depth(tmp_path / "a.png", frame.depth, intrinsics=frame.intrinsics, pose=frame.pose, scale=0.0005)
    back = DepthFrame(*read_depth(tmp_path / "a.png"))
    np.testing.assert_allclose(back.depth, frame.depth, rtol=0, atol=0.00025 + 1e-12)
    np.testing.assert_array_equal(back.pose, frame.pose)
    assert back.intrinsics == frame.intrinsics


@pytest.mark.parametrize(
    ("meaning", "says"),
    [
        ("{", "is not JSON"),
        ("[]", "lacks intrinsics"),
        ({"scale": 1}, "lacks intrinsics"),
        (PINHOLE | {"depth_scale": 1}, "key 'depth_scale'; expected intrinsics, scale, pose"),
        (PINHOLE | {"intrinsics": [1, 2, 3]}, r"intrinsics in the .json has shape \(3,\)"),
        (PINHOLE | {"intrinsics": ["a", 1, 1, 1]}, "not made of numbers"),
        (PINHOLE | {"intrinsics": [0, 1, 1, 1]}, "not above 0"),
        (PINHOLE | {"scale": -0.001}, "not above 0"),
        ('{"intrinsics": [1, 1, NaN, 1]}', "finite"),
        (PINHOLE | {"pose": np.diag([1, 1, 2, 1]).tolist()}, "no rotation"),
        (PINHOLE | {"pose": np.diag([1, 1, -1, 1]).tolist()}, "no rotation"),
    ],
)
def test_a_sidecar_that_cannot_be_is_refused(tmp_path, meaning, says):
    path = write_pair(tmp_path, meaning=meaning)
    with pytest.raises(CloudError, match=says):
        read_cloud(path)
    with pytest.raises(CloudError, match=says):
        read_depth(path)


def test_images_that_are_no_depth_are_refused(tmp_path):
    path = write_pair(tmp_path, np.zeros((4, 4, 3), np.uint8))
    with pytest.raises(CloudError, match="mode RGB; expected grey of 16 bits"):
        read_cloud(path)
    whole = write_pair(tmp_path, np.random.default_rng(0).integers(1, 9999, (20, 30), np.uint16)).read_bytes()
    for length in range(1, len(whole) - 30, 7):  # the last bytes are check sums
        path.write_bytes(whole[:length])
        with pytest.raises(CloudError, match=r"a\.png"):
            read_cloud(path)
    path = write_pair(tmp_path, np.zeros((5000, 5000), np.uint16))
    with pytest.raises(CloudError, match="unpacks to 5000 x 5000"):
        read_cloud(path)
    path = write_pair(tmp_path, np.zeros((3, 3), np.uint16))
    with pytest.raises(CloudError, match="no point with three finite"):
        read_cloud(path)
    (tmp_path / "a.json").unlink()
    with pytest.raises(CloudError, match=r"no a\.json beside it"):
        read_cloud(path)


def test_points_are_not_written_as_an_image(tmp_path):
    with pytest.raises(CloudError, match="write_depth"):
        write_cloud(tmp_path / "a.png", POINTS)
    for depth, says in (
        (np.full((2, 2), 70.0), "up to 70 m"),
        (np.full((2, 2), -1.0), "expected 0.001"),
        ([], "shape"),
    ):
        with pytest.raises(CloudError, match=says):
            write_depth(tmp_path / "a.png", depth, intrinsics=(1, 1, 0, 0))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.json", "a.jpg", "a"])
def test_a_depth_image_ends_in_png(tmp_path, name):
    with pytest.raises(CloudError, match=r"suffix '.*'; expected \.png"):
        write_depth(tmp_path / name, [[1.0]], intrinsics=(1, 1, 0, 0))
    assert not list(tmp_path.iterdir())


def test_what_is_written_beside_a_depth_image_may_be_of_any_numeric_kind(tmp_path):
    kinds = {"intrinsics": np.array([1, 1, 0, 0], np.float32), "scale": np.float32(0.5), "pose": np.eye(4, dtype=int)}
    write_depth(tmp_path / "a.PNG", [[1.0, 2.0]], **kinds)
    np.testing.assert_array_equal(read_depth(tmp_path / "a.PNG").depth, [[1.0, 2.0]])
    for depth in ("x", [[1], [1, 2]]):
        with pytest.raises(CloudError, match="depth is not an array of numbers"):
            write_depth(tmp_path / "a.png", depth, intrinsics=(1, 1, 0, 0))
