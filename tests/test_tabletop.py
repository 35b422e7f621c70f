"""The real pairs against the manifest that stands beside them, and every way in which they may be missing."""

import functools
import hashlib
import http.server
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from gmmcd_teach.clouds import CloudError, read_fields, write_cloud
from gmmcd_teach.lab import tabletop
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS, hidden_from, static_pair, tabletop_available, tabletop_pair

REAL = Path(os.environ.get("GMMCD_TEACH_DATA") or Path(__file__).parents[2] / "shared/real")
MANIFEST = REAL / "tabletop/manifest.json"
needs_pairs = pytest.mark.skipif(not tabletop_available(REAL), reason="needs ../shared/real/tabletop")
needs_static = pytest.mark.skipif(not tabletop_available(REAL, "static"), reason="needs ../shared/real/static")
needs_manifest = pytest.mark.skipif(not MANIFEST.is_file(), reason="needs ../shared/real/tabletop/manifest.json")


@functools.cache
def real_pair(name):
    """One of the real pairs, unpacked once for all tests."""
    return tabletop_pair(name, REAL)


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No data nearby, an empty cache, and an address where nothing answers."""
    monkeypatch.delenv("GMMCD_TEACH_DATA", raising=False)
    monkeypatch.setattr(tabletop, "_cache", lambda: tmp_path / "cache")
    monkeypatch.setattr(tabletop, "SOURCE", "http://127.0.0.1:9/nothing")
    return tmp_path


@pytest.fixture
def served(nowhere, monkeypatch):
    """A tiny pair of files with their checksums recorded, and an address that serves them."""
    depth = np.full((2, 3), 1.0)
    depth[0, 0] = np.nan
    remote = nowhere / "remote/segmentation/mOSD/learn"
    remote.mkdir(parents=True)
    for stem, shift in (("learn6", 0.0), ("learn7", 0.1)):
        body = np.zeros(6, [("label", "<u4"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
        body["label"] = [0, 1, 20, 21, 30, 30]
        body["z"] = depth.ravel() + shift
        header = "FIELDS label x y z\nSIZE 4 4 4 4\nTYPE U F F F\nWIDTH 3\nHEIGHT 2\nDATA binary\n"
        (remote / f"{stem}.pcd").write_bytes(header.encode() + body.tobytes())
        digest = hashlib.sha256((remote / f"{stem}.pcd").read_bytes()).hexdigest()
        monkeypatch.setitem(tabletop._SHA256, stem, digest)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = lambda *args: Quiet(*args, directory=nowhere / "remote")  # noqa: E731
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        monkeypatch.setattr(tabletop, "SOURCE", f"http://127.0.0.1:{server.server_port}")
        yield remote
        server.shutdown()
        thread.join()


@needs_manifest
def test_registry_says_what_the_manifest_says():
    manifest = json.loads(MANIFEST.read_text())
    assert set(TABLETOP_PAIRS) == set(manifest["pairs"])
    assert manifest["source"]["commit"] in tabletop.SOURCE
    for name, facts in manifest["pairs"].items():
        pair = tabletop._PAIRS[name]
        assert [f"{pair.before}.pcd", f"{pair.after}.pcd"] == [facts["before"], facts["after"]]
        assert [tabletop._SHA256[pair.before], tabletop._SHA256[pair.after]] == facts["sha256"]
        assert list(pair.removed) == [item["label"] for item in facts["removed"]]
        assert list(pair.added) == [item["label"] for item in facts["added"]]


@pytest.mark.slow
@needs_pairs
@needs_manifest
@pytest.mark.parametrize("name", TABLETOP_PAIRS)
def test_pair_holds_what_the_manifest_counts(name):
    facts = json.loads(MANIFEST.read_text())["pairs"][name]
    pair = real_pair(name)
    assert (len(pair.before), len(pair.after)) == (facts["n_before"], facts["n_after"])
    for points, changed, items in [
        (pair.before, pair.disappeared, facts["removed"]),
        (pair.after, pair.appeared, facts["added"]),
    ]:
        assert changed.sum() == sum(item["n"] for item in items)
        centroid = sum(item["n"] * np.array(item["centroid"]) for item in items) / changed.sum()
        np.testing.assert_allclose(points[changed].mean(axis=0), centroid, atol=1e-3)
    for points, objects, hidden in [
        (pair.before, pair.before_objects, pair.hidden_before),
        (pair.after, pair.after_objects, pair.hidden_after),
    ]:
        assert points.dtype == np.float64
        assert np.isfinite(points).all()
        assert len(points) == len(objects) == len(hidden)
        assert not (hidden & (objects > 0)).any()
        assert 0 < hidden.mean() < 0.1
        assert objects.max() <= len(pair.object_names)


@needs_pairs
def test_points_lie_on_the_rays_of_their_pixels():
    pair = real_pair("bowl_removed_two_cups_added")
    for points, (frame,) in [(pair.before, pair.before_frames), (pair.after, pair.after_frames)]:
        fx, fy, cx, cy = frame.intrinsics
        v, u = np.nonzero(np.isfinite(frame.depth))
        z = frame.depth[v, u]
        np.testing.assert_allclose(points, np.column_stack([(u - cx) * z / fx, (v - cy) * z / fy, z]), atol=1e-6)
        np.testing.assert_array_equal(frame.pose, np.eye(4))
        assert frame.depth.shape == (480, 640)


@needs_pairs
def test_hidden_is_what_the_other_scan_has_nearer_or_not_at_all():
    pair = real_pair("tea_box_moved_sideways")
    before, after = pair.before_frames[0].depth, pair.after_frames[0].depth
    measured = np.isfinite(before)
    expected = (np.isnan(after) | (after < before - tabletop.NOISE))[measured] & ~pair.disappeared
    np.testing.assert_array_equal(pair.hidden_before, expected)


@pytest.mark.slow
@needs_pairs
@pytest.mark.parametrize("name", TABLETOP_PAIRS)
def test_noise_of_still_surface_stays_below_the_margin(name):
    pair = real_pair(name)
    depths = [pair.before_frames[0].depth, pair.after_frames[0].depth]
    table = np.isfinite(depths[0]) & np.isfinite(depths[1])
    for stem in (tabletop._PAIRS[name].before, tabletop._PAIRS[name].after):
        table &= read_fields(REAL / f"tabletop/{stem}.pcd")["label"] < 10
    assert np.quantile(np.abs(depths[1] - depths[0])[table], 0.999) < tabletop.NOISE


@needs_static
def test_static_room_coincides_where_both_scans_saw_it():
    pair = static_pair(REAL)
    assert not pair.appeared.any()
    assert not pair.disappeared.any()
    shift = np.linalg.norm(pair.after_frames[0].pose[:3, 3])
    angle = np.arccos((np.trace(pair.after_frames[0].pose[:3, :3]) - 1) / 2)
    assert 0.10 < shift < 0.12
    assert np.deg2rad(1.2) < angle < np.deg2rad(1.4)
    tree = KDTree(pair.before)
    aligned = np.median(tree.query(pair.after[~pair.hidden_after][::10])[0])
    pose = pair.after_frames[0].pose
    as_recorded = (pair.after - pose[:3, 3]) @ pose[:3, :3]
    apart = np.median(tree.query(as_recorded[::10])[0])
    assert aligned < 0.007
    assert apart > 2 * aligned


def test_hidden_from_by_hand():
    depth = np.array([[1.0, np.nan], [2.0, 2.0]])
    pose = np.eye(4)
    pose[:3, 3] = [0, 0, 10]
    pose[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # the camera looks along world x
    frame = DepthFrame(depth, pose, (1.0, 1.0, 0.0, 0.0))
    cases = {  # camera coordinates -> hidden
        (0, 0, 1.0): False,
        (0, 0, 1.01): False,
        (0, 0, 1.02): True,
        (0, 0, 0.5): False,
        (1, 0, 1.0): True,  # no return
        (0, 1.5, 1.5): False,
        (0, 2.2, 2.2): True,
        (0, 0, -1.0): True,  # behind
        (-3, 0, 1.0): True,  # beside
        (0, 9, 1.0): True,
    }
    world = np.array(list(cases)) @ pose[:3, :3].T + pose[:3, 3]
    assert hidden_from(world, frame).tolist() == list(cases.values())


def test_unknown_names():
    with pytest.raises(ValueError, match="name is 'tea'; expected one of tea_box_moved_front_to_back"):
        tabletop_pair("tea")
    with pytest.raises(ValueError, match="folder is 'chairs'; expected one of tabletop, static"):
        tabletop_available(folder="chairs")


def test_no_file_and_no_network_is_one_clear_line(nowhere):
    assert not tabletop_available()
    with pytest.raises(CloudError, match=r"learn6.pcd: not on this machine.*GMMCD_TEACH_DATA=DIR") as caught:
        tabletop_pair("tea_box_moved_front_to_back", nowhere)
    assert "\n" not in str(caught.value)
    assert caught.value.__suppress_context__
    with pytest.raises(CloudError, match=r"capture0001.pcd: .*put the file in DIR/static"):
        static_pair()


def test_other_content_is_refused(nowhere):
    (nowhere / "tabletop").mkdir()
    write_cloud(nowhere / "tabletop/learn6.pcd", np.ones((3, 3)))
    with pytest.raises(CloudError, match="not the recorded file"):
        tabletop_pair("tea_box_moved_front_to_back", nowhere)


@pytest.mark.slow
def test_fetching_says_nothing_on_stderr(served, nowhere):
    """What a chapter prints there fails the book; a fresh process, for pooch keeps the first stderr that it saw."""
    code = (
        "from pathlib import Path\nfrom gmmcd_teach.lab import tabletop\n"
        f"tabletop._cache = lambda: Path({str(nowhere / 'fresh')!r})\n"
        f"tabletop.SOURCE, tabletop._SHA256 = {tabletop.SOURCE!r}, {tabletop._SHA256!r}\n"
        "assert len(tabletop.tabletop_pair('tea_box_moved_front_to_back').before) == 5"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_fetched_once_then_from_the_cache(served, monkeypatch):
    pair = tabletop_pair("tea_box_moved_front_to_back")
    assert pair.before_objects.tolist() == [0, 1, 1, 0, 0]
    assert pair.after_objects.tolist() == [0, 0, 0, 1, 1]
    np.testing.assert_allclose(pair.after[:, 2], 1.1, rtol=1e-6)
    monkeypatch.setattr(tabletop, "SOURCE", "http://127.0.0.1:9/nothing")
    again = tabletop_pair("tea_box_moved_front_to_back")
    np.testing.assert_array_equal(again.before, pair.before)


def test_fetched_file_of_other_content_is_refused(served, monkeypatch):
    monkeypatch.setitem(tabletop._SHA256, "learn7", "0" * 64)
    with pytest.raises(CloudError, match=r"learn7.pcd: .* cannot be fetched \(ValueError\)"):
        tabletop_pair("tea_box_moved_front_to_back")


def test_looked_for_in_order(served, nowhere, monkeypatch):
    """The folder given, then the variable, then the cache: the first that has the file decides."""
    good, bad = nowhere / "good", nowhere / "bad"
    shutil.copytree(served, good / "tabletop")
    (bad / "tabletop").mkdir(parents=True)
    (bad / "tabletop/learn6.pcd").write_bytes(b"something else")
    monkeypatch.setattr(tabletop, "SOURCE", "http://127.0.0.1:9/nothing")
    name = "tea_box_moved_front_to_back"

    monkeypatch.setenv("GMMCD_TEACH_DATA", str(bad))
    assert len(tabletop_pair(name, good).before) == 5
    with pytest.raises(CloudError, match="bad"):
        tabletop_pair(name)
    monkeypatch.setenv("GMMCD_TEACH_DATA", str(good))
    assert len(tabletop_pair(name).before) == 5
    assert len(tabletop_pair(name, nowhere / "empty").before) == 5
    with pytest.raises(CloudError, match="bad"):
        tabletop_pair(name, bad)
    monkeypatch.delenv("GMMCD_TEACH_DATA")
    shutil.copytree(good / "tabletop", nowhere / "cache/tabletop")
    assert len(tabletop_pair(name).before) == 5
