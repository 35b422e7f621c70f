"""Beyond the paper: each method against a plain loop or a library, and the scores that the best one must reach."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.sparse import csr_matrix
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from gmmcd_teach import (
    METHODS,
    CloudError,
    GaussianMixture,
    confusion,
    detect_changes,
    simulate_pair,
)
from gmmcd_teach.beyond.alignment import align
from gmmcd_teach.beyond.baselines import along_normals, detect_c2c, detect_occupancy, m3c2_distances
from gmmcd_teach.beyond.recommended import FEWEST, without_specks
from gmmcd_teach.beyond.shared import (
    changed_components,
    one_side,
    other_scan_says,
    surface_patches,
    unbalanced_emd,
    votes,
)
from gmmcd_teach.beyond.surface import distinct, point_spacing, surface_of
from gmmcd_teach.beyond.visibility import ANSWERS, judge, looks_from, looks_of_frames
from gmmcd_teach.filtering import voxel_downsample
from gmmcd_teach.lab import DepthFrame, ScenePair, static_pair, tabletop_pair
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS, tabletop_available
from gmmcd_teach.study.scans import backwards
from gmmcd_teach.study.scores import score

PAPER = ("cargo_bag", "astrobee", "two_objects", "three_objects")
HELD_OUT = (0, 1)  # the constants of `recommended` were set on seeds from 1000 on


def floor_with(height: float, size: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A floor, and the floor with a plate above its middle that hides part of it from nobody."""
    side = np.arange(40) * 0.02
    floor = np.stack(np.meshgrid(side, side, [0.0]), -1).reshape(-1, 3)
    plate = np.stack(np.meshgrid(side[:size] + 0.2, side[:size] + 0.2, [height]), -1).reshape(-1, 3)
    return floor, np.concatenate([floor, plate])


@pytest.mark.parametrize("method", [name for name in METHODS if name != "greedy"])
def test_a_plate_comes_or_goes(method: str) -> None:
    floor, with_plate = floor_with(0.4)
    options = {"max_components": 6} if method == "shared" else {}
    come = detect_changes(floor, with_plate, method=method, **options)
    gone = detect_changes(with_plate, floor, method=method, **options)
    assert come.appeared[1600:].mean() > 0.95
    assert not come.appeared[:1600].any()
    assert not come.disappeared.any()
    assert gone.disappeared[1600:].mean() > 0.95
    assert not gone.appeared.any()
    assert {"filter", "pca", "em", "emd", "total"} <= set(come.seconds)


@pytest.mark.parametrize("method", list(METHODS))
def test_arguments_stay_and_answers_repeat(method: str) -> None:
    pair = floor_with(0.4)
    copies = [cloud.copy() for cloud in pair]
    answers = [detect_changes(*pair, method=method, max_components=4, rng=3) for _ in range(2)]
    assert np.array_equal(answers[0].appeared, answers[1].appeared)
    assert all(np.array_equal(cloud, copy) for cloud, copy in zip(pair, copies, strict=True))


@pytest.mark.parametrize("method", ["shared", "recommended", "c2c", "m3c2", "occupancy"])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_handful_of_points_is_no_error(method: str, n: int) -> None:
    few = np.random.default_rng(0).normal(size=(n, 3))
    found = detect_changes(few, few + 0.001, method=method, max_components=1)
    assert found.appeared.shape == found.disappeared.shape == (n,)


def test_c2c_is_a_loop_over_all_pairs() -> None:
    rng = np.random.default_rng(0)
    before, after = rng.uniform(0, 1, (200, 3)), rng.uniform(0.2, 1.2, (150, 3))
    reach = 3 * np.hypot(0.02, 0.03) + max(point_spacing(before), point_spacing(after))
    found = detect_c2c(before, after, noise=0.02, alignment_error=0.03)
    assert np.array_equal(found.appeared, cdist(after, before).min(axis=1) > reach)
    assert np.array_equal(found.disappeared, cdist(before, after).min(axis=1) > reach)


def test_occupancy_is_a_loop_over_cells() -> None:
    rng = np.random.default_rng(1)
    before, after = rng.uniform(0, 1, (60, 3)), rng.uniform(-0.2, 0.8, (50, 3))
    cells = {tuple(cell) for cell in np.floor(before / 0.1).astype(int)}
    block = [np.array([i, j, k]) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    expected = [not any(tuple(np.floor(p / 0.1).astype(int) + b) in cells for b in block) for p in after]
    assert np.array_equal(detect_occupancy(before, after, leaf_size=0.1).appeared, expected)


def test_m3c2_statistics_are_those_of_the_cylinder() -> None:
    rng = np.random.default_rng(2)
    points = rng.normal(0, 0.3, (2000, 3))
    cores, normals = rng.normal(0, 0.1, (20, 3)), rng.normal(size=(20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    count, mean, variance = along_normals(cores, normals, points, 0.1, 0.35)
    for k in range(20):
        offset = points - cores[k]
        height = offset @ normals[k]
        inside = (np.linalg.norm(offset - height[:, None] * normals[k], axis=1) <= 0.1) & (np.abs(height) <= 0.35)
        assert count[k] == inside.sum()
        np.testing.assert_allclose([mean[k], variance[k]], [height[inside].mean(), height[inside].var(ddof=1)])


def test_m3c2_agrees_with_py4dgeo() -> None:
    py4dgeo = pytest.importorskip("py4dgeo")
    rng = np.random.default_rng(3)
    here, there = (rng.uniform(0, 1, (4000, 3)) * [1, 1, 0.02] + [0, 0, h] for h in (0.0, 0.05))
    cores = here[:50]
    up = np.tile([0.0, 0.0, 1.0], (50, 1))
    epochs = py4dgeo.Epoch(here), py4dgeo.Epoch(there)
    theirs = py4dgeo.M3C2(
        epochs=epochs, corepoints=cores, corepoint_normals=up, cyl_radius=0.1, max_distance=0.5, registration_error=0.01
    )
    distances, uncertainty = theirs.run()
    ours, detectable = m3c2_distances(cores, up, here, there, 0.1, 0.5, 0.01)
    np.testing.assert_allclose(ours, distances, atol=1e-6)
    np.testing.assert_allclose(detectable, uncertainty["lodetection"], rtol=0.02)


def test_components_are_judged_by_the_binomial_test() -> None:
    rng = np.random.default_rng(4)
    old, new = rng.integers(0, 40, (2, 200))
    gone, come = changed_components(old, new, 0.8, 0.05)
    for k, (b, a) in enumerate(zip(old, new, strict=True)):
        n = int(a + b)
        chance = binomtest(int(b), n, 0.5, alternative="less").pvalue if n else 1.0
        assert come[k] == (chance < 0.05 / 400 and a >= 0.8 * n)
        assert not (gone[k] and come[k])


def test_false_alarms_are_as_rare_as_asked() -> None:
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(200):
        total = rng.integers(5, 60, 40)
        new = rng.binomial(total, 0.5)
        alarms += sum(flags.sum() for flags in changed_components(total - new, new, 0.51, 0.05))
    assert alarms <= 25  # 10 expected at most


def test_lone_points_are_no_surface_unless_most_are_alone() -> None:
    rng = np.random.default_rng(8)
    sheet, strays = rng.uniform(0, 1, (5000, 3)) * [1, 1, 0], rng.uniform(0, 1, (200, 3))
    cloud = np.concatenate([sheet, strays])
    cells, number = np.unique(np.floor(cloud / 0.05).astype(int), axis=0, return_inverse=True)
    several = [cloud[number.ravel() == k].mean(axis=0) for k in range(len(cells)) if np.sum(number == k) > 1]
    np.testing.assert_allclose(np.sort(surface_patches(cloud, 0.05), axis=0), np.sort(several, axis=0))
    assert len(surface_patches(strays, 0.05)) == len(voxel_downsample(strays, 0.05).centroids)


def test_votes_are_counted_for_each_component() -> None:
    rng = np.random.default_rng(9)
    means = rng.normal(0, 3, (4, 3))
    mixture = GaussianMixture(np.full(4, 0.25), means, np.tile(np.eye(3), (4, 1, 1)))
    patches, past, met = rng.normal(0, 3, (300, 3)), rng.random(300) < 0.3, rng.random(300) < 0.5
    expected = np.zeros((3, 4))
    for patch, p, m in zip(patches, past, met, strict=True):
        expected[:, np.linalg.norm(means - patch, axis=1).argmin()] += [1, p, m]
    np.testing.assert_array_equal(votes(mixture, patches, (past, met)), expected)


def test_a_side_keeps_the_components_that_can_be_judged() -> None:
    places = np.arange(4.0)[:, None] * 100
    mixture = GaussianMixture(np.full(4, 0.25), places, np.ones((4, 1, 1)))
    held = np.array([50.0, 11.0, 10.0, 0.0])
    side = one_side(mixture, held, np.repeat(places, held.astype(int), axis=0), fewest=10.5)
    np.testing.assert_allclose(side.weights, np.array([50, 11, 0, 0]) / 61)
    few = one_side(mixture, held / 10, places[[0, 0, 0, 1]], fewest=10.5)
    np.testing.assert_allclose(few.weights, [1, 0, 0, 0])


@pytest.mark.slow
def test_no_patch_is_both_looked_past_and_met_by_a_sensor_that_is_told() -> None:
    pair = simulate_pair("mixed_frame", 3, noise=False, pose_error=False)
    past, met = other_scan_says(pair.before, pair.after, None, pair.after_frames, 0.03)
    assert not (past & met).any()
    near = cdist(pair.before[::50], pair.after).min(axis=1) < 0.03
    assert met[::50][near].all()
    assert past[pair.disappeared].mean() > 0.85
    assert (past | met)[pair.hidden_before].mean() < 0.2
    both = other_scan_says(pair.before, pair.after, None, None, 0.03)
    assert np.all(both)


def test_what_is_new_does_not_witness_that_something_has_stayed() -> None:
    """One component explains two slats that go and one that comes between them."""
    floor, with_plate = floor_with(0.3, size=24)
    plate = with_plate[1600:]
    between = np.abs(plate[:, 0] - 0.43) < 0.08
    before, after = (np.concatenate([floor, slats]) for slats in (plate[~between], plate[between]))
    eye = {"before_origin": [0.4, 0.4, 2.0], "after_origin": [0.4, 0.4, 2.0]}
    found = detect_changes(before, after, method="shared", max_components=1, **eye)  # type: ignore[arg-type]
    assert found.after_mixture is not None
    assert found.after_mixture.n_components == 2
    assert found.disappeared[1600:].all()
    assert found.appeared[1600:].all()
    assert not found.disappeared[:1600].any()
    assert not found.appeared[:1600].any()


def test_unbalanced_transport_is_the_programme_with_both_prices_written_out() -> None:
    rng = np.random.default_rng(6)
    p, q, cost = rng.uniform(size=5), rng.uniform(size=4), rng.uniform(0, 2, (5, 4))
    flow, destroyed, created = unbalanced_emd(p, q, cost, 0.4)
    sums = np.vstack([np.kron(np.eye(5), np.ones(4)), np.kron(np.ones(5), np.eye(4))])
    full = linprog(
        np.concatenate([cost.ravel(), np.full(9, 0.4)]), A_eq=np.hstack([sums, np.eye(9)]), b_eq=np.append(p, q)
    )
    np.testing.assert_allclose((flow * cost).sum() + 0.4 * (destroyed.sum() + created.sum()), full.fun)
    assert not flow[cost > 0.8].any()
    np.testing.assert_allclose(flow.sum(axis=1) + destroyed, p)


def test_looks_of_a_frame_pixel_by_pixel() -> None:
    rng = np.random.default_rng(7)
    depth = rng.uniform(1, 3, (20, 30))
    depth[rng.random(depth.shape) < 0.02] = np.nan
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix(), [0.3, 0.1, -0.2]
    points = rng.uniform([-1, -1, 0.5], [1, 1, 3], (500, 3))
    looks = looks_of_frames(points, [DepthFrame(depth, pose, (20.0, 20.0, 14.5, 9.5))], 0.1)
    padded = np.pad(np.where(np.isnan(depth), -np.inf, depth), 1, mode="edge")
    for i, point in enumerate(points):
        x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
        u, v = int(np.rint(20 * x / z + 14.5)), int(np.rint(20 * y / z + 9.5))
        if z <= 0 or not (0 <= u < 30 and 0 <= v < 20):
            assert looks.past[i] == looks.met[i] == 0
            continue
        assert looks.past[i] == (padded[v : v + 3, u : u + 3].min() > z + 0.1)
        assert looks.met[i] == (abs(depth[v, u] - z) <= 0.1)


def test_rays_from_a_position_agree_with_the_depth_frame() -> None:
    pair = simulate_pair("mixed_frame", 3, noise=False, pose_error=False)
    frame = pair.after_frames[0]
    by_frame = looks_of_frames(pair.before, [frame], 0.05)
    by_rays = looks_from(pair.before, frame.pose[:3, 3], pair.after, 0.05)
    assert (by_frame.past == by_rays.past).mean() > 0.97
    assert by_rays.past[pair.disappeared].mean() > 0.8
    assert not by_rays.past[pair.hidden_before].mean() > 0.05


def test_shadows_are_unknown_and_objects_changed() -> None:
    pair = simulate_pair("mixed_frame", 3, noise=False, pose_error=False)
    answer = judge(pair.before, pair.after, frames=pair.after_frames, margin=0.04)
    assert (answer[pair.disappeared] == ANSWERS.index("changed")).mean() > 0.85
    assert (answer[pair.hidden_before] == ANSWERS.index("changed")).mean() < 0.03
    rest = ~pair.disappeared & ~pair.hidden_before
    assert (answer[rest] == ANSWERS.index("unchanged")).mean() > 0.95


@pytest.mark.parametrize("seed", range(5))
def test_icp_finds_the_motion_though_an_object_has_come(seed: int) -> None:
    rng = np.random.default_rng(seed)
    room = rng.uniform(0, 2, (6000, 3))
    room[np.arange(6000), np.arange(6000) % 3] = 0.0
    thing = rng.uniform([0.5, 0.5, 0], [1.0, 1.0, 0.5], (800, 3))
    turn = rng.normal(size=3)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.radians(2) * turn / np.linalg.norm(turn)).as_matrix()
    shift = rng.normal(size=3)
    motion[:3, 3] = 0.05 * shift / np.linalg.norm(shift)
    seen = np.concatenate([room, thing]) @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(align(seen, room, max_distance=0.2) @ motion, np.eye(4), atol=2e-3)


def test_icp_does_not_slide_along_a_lone_wall() -> None:
    wall = np.random.default_rng(0).uniform(0, 1, (3000, 3)) * [1, 1, 0]
    motion = align(wall + np.array([0.02, 0.01, 0.03]), wall)
    np.testing.assert_allclose(motion[:3, 3], [0, 0, -0.03], atol=1e-3)


def test_normals_are_those_of_the_plane() -> None:
    turn = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    flat = np.random.default_rng(0).uniform(0, 1, (2000, 3)) * [1, 1, 0] @ turn.T
    normals = surface_of(flat, 0.05, towards=np.tile(turn[:, 2], (2000, 1))).normals
    np.testing.assert_allclose(normals, np.tile(turn[:, 2], (len(normals), 1)), atol=1e-8)


@pytest.mark.parametrize(
    ("method", "options", "says"),
    [
        ("c2c", {"noise": -1}, "noise"),
        ("occupancy", {"leaf_size": 0.0, "alignment_error": -1.0}, "alignment_error|leaf_size"),
        ("m3c2", {"max_depth": "far"}, "max_depth"),
        ("shared", {"share": 0.2}, "share"),
        ("recommended", {"leaf_size": -1.0}, "leaf_size"),
        ("recommended", {"depth": 1}, "before_frames"),
    ],
)
def test_options_out_of_range_are_named(method: str, options: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        detect_changes(*floor_with(0.4), method=method, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["m3c2", "recommended"])
def test_flat_clouds_are_refused_where_normals_are_needed(method: str) -> None:
    with pytest.raises(CloudError, match="D = 3"):
        detect_changes(np.zeros((9, 2)), np.zeros((9, 2)), method=method)


def point_scores(pair: ScenePair, *, swap: bool = False, **options: object) -> tuple[float, float]:
    """F1 per point of what appeared and of what disappeared, all points counted."""
    sides = [(pair.before, pair.disappeared, pair.before_frames), (pair.after, pair.appeared, pair.after_frames)]
    (old, gone, old_frames), (new, come, new_frames) = sides[::-1] if swap else sides
    told = options or {"before_frames": old_frames, "after_frames": new_frames}
    found = detect_changes(old, new, method="recommended", **told)  # type: ignore[arg-type]
    return confusion(found.appeared, come).f1, confusion(found.disappeared, gone).f1


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["cargo_bag", "astrobee", "mixed_frame", "moved", "touching"])
def test_recommended_on_single_frames(scene: str) -> None:
    assert min(point_scores(simulate_pair(scene, 0))) >= 0.96


@pytest.mark.slow
def test_recommended_finds_what_stands_in_the_place_of_another() -> None:
    assert min(point_scores(simulate_pair("replaced", 0))) >= 0.85  # what the old thing hid is told by its seams alone


@pytest.mark.scores
@pytest.mark.parametrize("seed", HELD_OUT)
@pytest.mark.parametrize("scene", [*PAPER, "mixed", "mixed_frame"])
def test_recommended_reaches_its_scores(scene: str, seed: int) -> None:
    pair = simulate_pair(scene, seed)
    assert min(*point_scores(pair), *point_scores(pair, swap=True)) >= 0.96


@pytest.mark.scores
def test_nothing_is_found_where_nothing_changed() -> None:
    quiet = 0
    for seed in range(20):
        pair = simulate_pair("unchanged", seed)
        found = detect_changes(
            pair.before,
            pair.after,
            method="recommended",
            before_frames=pair.before_frames,
            after_frames=pair.after_frames,
        )
        quiet += not (found.appeared.any() or found.disappeared.any())
    assert quiet >= 19


@pytest.mark.scores
@pytest.mark.parametrize("scene", PAPER)
def test_shared_mixture_reaches_its_scores(scene: str) -> None:
    scores = []
    for seed in HELD_OUT:
        pair = simulate_pair(scene, seed)
        for one in (pair, backwards(pair)):
            told = {"before_frames": one.before_frames, "after_frames": one.after_frames}
            found = detect_changes(one.before, one.after, method="shared", **told)  # type: ignore[arg-type]
            rows = [row for row in score(found, one) if row["tp"] + row["fn"]]
            scores += [row["f1"] for row in rows if row["level"] == "component"]
            assert min(row["f1"] for row in rows if row["level"] == "point") >= 0.96
    assert np.mean(scores) >= 0.98


@pytest.mark.slow
@pytest.mark.parametrize("seed", HELD_OUT)
def test_shared_mixture_is_silent_where_nothing_changed(seed: int) -> None:
    pair = simulate_pair("unchanged", seed)
    told = {"before_frames": pair.before_frames, "after_frames": pair.after_frames}
    found = detect_changes(pair.before, pair.after, method="shared", **told)  # type: ignore[arg-type]
    assert not found.appeared.any()
    assert not found.disappeared.any()


@pytest.mark.slow
def test_recommended_on_the_table() -> None:
    if not tabletop_available():
        pytest.skip("no real table-top scans on this machine")
    camera = {"before_origin": np.zeros(3), "after_origin": np.zeros(3)}
    scores = np.array([point_scores(tabletop_pair(name), **camera) for name in TABLETOP_PAIRS])
    assert scores.min() >= 0.95
    assert (scores.mean(axis=0) >= 0.98).all()


@pytest.mark.slow
def test_recommended_is_silent_in_a_real_room_where_nothing_changed() -> None:
    try:
        pair = static_pair()
    except CloudError:
        pytest.skip("no real static room on this machine")
    found = detect_changes(
        pair.before,
        pair.after,
        method="recommended",
        before_origin=pair.before_frames[0].pose[:3, 3],
        after_origin=pair.after_frames[0].pose[:3, 3],
    )
    assert not found.appeared.any()
    assert not found.disappeared.any()


def test_a_patch_needs_evidence_of_its_own() -> None:
    line = np.arange(120)
    graph = csr_matrix((np.ones(119), (line[:-1], line[1:])), shape=(120, 120))
    changed = (line < 40) | ((line >= 50) & (line < 90)) | (line >= 100)  # three patches of 40, 40 and 20 cells
    evidence = (line < FEWEST) | ((line >= 50) & (line < 50 + FEWEST - 1)) | (line >= 100)
    np.testing.assert_array_equal(without_specks(changed, evidence, graph + graph.T), line < 40)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_misaligned_scans_are_as_good_once_aligned(seed: int) -> None:
    pair = simulate_pair("mixed_frame", seed)
    turn = np.random.default_rng(seed).normal(size=3)
    off = np.eye(4)
    off[:3, :3] = Rotation.from_rotvec(np.radians(2) * turn / np.linalg.norm(turn)).as_matrix()
    off[:3, 3] = 0.05 * np.array([0.6, 0.8, 0.0])
    after = pair.after @ off[:3, :3].T + off[:3, 3]
    frames = [DepthFrame(f.depth, off @ f.pose, f.intrinsics) for f in pair.after_frames]
    found = detect_changes(
        pair.before, after, method="recommended", before_frames=pair.before_frames, after_frames=frames
    )
    scores = confusion(found.appeared, pair.appeared).f1, confusion(found.disappeared, pair.disappeared).f1
    assert min(scores) >= min(point_scores(pair)) - 0.05


def as_two_scans() -> tuple[np.ndarray, np.ndarray]:
    """Two scans of a floor with a wall, and a plate that has come in the second: 150 new points, at the end."""
    rng = np.random.default_rng(0)
    floor, with_plate = floor_with(0.4)
    wall = floor[:, [0, 2, 1]] + [0, 0.79, 0.02]
    before, after = np.concatenate([floor, wall]), np.concatenate([floor, wall, with_plate[1600:]])
    return before + rng.normal(0, 1e-3, before.shape), after + rng.normal(0, 1e-3, after.shape)


@pytest.mark.parametrize(
    ("moved", "says"),
    [
        (lambda s: s + np.array([20, 0, 0]), "do not lie on each other"),
        (lambda s: s + np.array([20, 0, 0]), r"boxes are 19.* m apart"),
        (lambda s: 10 * s, "fit only to within"),
        (lambda s: s[:1] + 9, "do not lie on each other"),
    ],
    ids=["in another frame", "on the same plane", "in another unit", "one point"],
)
@pytest.mark.parametrize("told", [False, True])
def test_scans_that_do_not_lie_on_each_other_are_refused(moved, says: str, told: bool) -> None:
    before, after = as_two_scans()
    stood = {"before_origin": [0.4, 0.2, 2.0], "after_origin": moved(np.array([[0.4, 0.2, 2.0]]))[0]} if told else {}
    if "boxes" in says:
        before, after = before[:1600], after[:1600]
    with pytest.raises(CloudError, match=says):
        detect_changes(before, moved(after), method="recommended", **stood)  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "told"),
    [("recommended", False), ("recommended", True), ("m3c2", False), ("c2c", False), ("occupancy", False)],
)
def test_repeated_points_and_fillers_hide_nothing(method: str, told: bool) -> None:
    before, after = as_two_scans()
    stood = {"before_origin": [0.4, 0.2, 2.0], "after_origin": [0.4, 0.2, 2.0]} if told else {}
    new = np.arange(len(after)) >= len(before)
    for old_cloud, new_cloud, truth in (
        (before, after, new),
        (before.repeat(12, axis=0), after.repeat(12, axis=0), new.repeat(12)),
        (
            np.vstack([before, np.zeros((4000, 3))]),
            np.vstack([after, np.zeros((4000, 3))]),
            np.append(new, [False] * 4000),
        ),
    ):
        found = detect_changes(old_cloud, new_cloud, method=method, **stood)  # type: ignore[arg-type]
        assert confusion(found.appeared, truth).recall > 0.95
        assert found.appeared[~truth].mean() < 0.02


def test_spacing_is_that_of_distinct_points() -> None:
    rng = np.random.default_rng(0)
    cloud = rng.uniform(0, 1, (500, 3))
    once = point_spacing(cloud)
    shuffled = cloud.repeat(rng.integers(1, 30, 500), axis=0)
    assert point_spacing(shuffled) == once
    np.testing.assert_array_equal(distinct(shuffled), cloud)
    assert point_spacing(np.zeros((50, 3))) == 0


@pytest.mark.parametrize(
    ("method", "option", "values"),
    [
        ("greedy", "max_components", (None, "5", [5], True, 0, 2.5)),
        ("greedy", "ground", (["means"], None)),
        ("greedy", "leaf_size", (0, "x")),
        ("shared", "max_components", (None, "5", [5], True)),
        ("shared", "share", ("x", [0.7], 1)),
        ("shared", "false_alarms", (0, -1, "x", None, np.nan)),
        ("shared", "patch_size", (0, "x")),
        ("shared", "leaf_size", (0, True)),
        ("shared", "before_frames", ([1], "x", 3)),
        ("shared", "before_origin", ([0, 0], "x")),
        ("recommended", "leaf_size", (0, "x", [0.1], np.nan)),
        ("recommended", "after_frames", ([1], "x")),
        ("c2c", "noise", (None, "x")),
        ("m3c2", "leaf_size", (0, "x", [0.1])),
        ("m3c2", "cylinder_radius", (0, -1, "x", 1e-12)),
        ("m3c2", "max_depth", (0, None, "x")),
        ("m3c2", "alignment_error", (None, "x")),
        ("occupancy", "alignment_error", (None, "x", -1)),
        ("occupancy", "leaf_size", (0, [0.1])),
    ],
    ids=str,
)
def test_options_of_a_wrong_kind_are_named(method: str, option: str, values: tuple[object, ...]) -> None:
    for value in values:
        with pytest.raises(ValueError, match=option):
            detect_changes(*floor_with(0.4), method=method, **{"max_components": 3, option: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["shared", "recommended"])
def test_no_frames_are_as_good_as_not_told(method: str) -> None:
    pair = as_two_scans()
    answers = [
        detect_changes(*pair, method=method, max_components=4, before_frames=frames, after_frames=frames)
        for frames in (None, (), [])
    ]
    assert answers[0].appeared.any()
    assert all(np.array_equal(answers[0].appeared, other.appeared) for other in answers[1:])


@pytest.mark.parametrize("method", list(METHODS.values()))
def test_clouds_of_different_dimension_are_refused_by_each_method(method) -> None:
    with pytest.raises(CloudError, match="after: shape"):
        method(np.zeros((9, 3)), np.zeros((9, 2)))


def test_a_place_is_judged_only_from_a_position() -> None:
    cloud = np.zeros((9, 3))
    with pytest.raises(CloudError, match=r"origin: shape \(2,\)"):
        judge(cloud, cloud, origin=[0, 0])
    with pytest.raises(CloudError, match=r"origin: .* holds NaN"):
        judge(cloud, cloud, origin=[0, 0, np.nan])
    with pytest.raises(CloudError, match="frames: holds int"):
        judge(cloud, cloud, frames=[1])  # type: ignore[list-item]
