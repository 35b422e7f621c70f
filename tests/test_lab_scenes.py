"""The scenes: reproducible pairs whose truth comes from the geometry, and maps that lie on the surfaces."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest

from gmmcd_teach.lab import SCENES, ScenePair, scene_worlds, simulate_pair
from gmmcd_teach.lab.camera import DepthCamera, frame_points, project
from gmmcd_teach.lab.fusion import VOXEL, fuse, seen_through, signed_distance, surface_squares
from gmmcd_teach.lab.granite import ROBOT_HEIGHT, SEARCH_BOUNDARY
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.lab.scenes import RECIPES
from gmmcd_teach.lab.shapes import Box, inverse, pose_at, transform
from gmmcd_teach.lab.survey import STATIONS, camera_pose, perturbed, survey_path
from gmmcd_teach.lab.truth import TOLERANCE, changed_names, object_numbers, visible
from gmmcd_teach.lab.world import Scene, Thing

FRAMES = [name for name in SCENES if RECIPES[name].station]
MAPS = [name for name in SCENES if not RECIPES[name].station]
PAPER = ("cargo_bag", "astrobee", "two_objects", "three_objects")


@cache
def pair_of(scene: str, seed: int = 0, noise: bool = True, pose_error: bool = True) -> ScenePair:
    return simulate_pair(scene, seed, noise=noise, pose_error=pose_error)


def check_pair(pair: ScenePair) -> None:
    """What holds for every pair, single frame or map."""
    for points, objects, hidden in (
        (pair.before, pair.before_objects, pair.hidden_before),
        (pair.after, pair.after_objects, pair.hidden_after),
    ):
        assert points.shape == (len(objects), 3)
        assert hidden.shape == objects.shape
        assert ((points >= SEARCH_BOUNDARY[0]) & (points <= SEARCH_BOUNDARY[1])).all()
        assert objects.min() >= 0
        assert objects.max() <= len(pair.object_names)
        assert not (hidden & (objects > 0)).any()
    before, after = scene_worlds(pair.name)
    for number, name in enumerate(pair.object_names, start=1):
        for world, objects in ((before, pair.before_objects), (after, pair.after_objects)):
            assert (objects == number).any() == (name in world.names)


@pytest.mark.slow
@pytest.mark.parametrize("scene", FRAMES)
def test_single_frames_carry_truth_for_every_point(scene: str) -> None:
    pair = pair_of(scene)
    check_pair(pair)
    assert len(pair.before_frames) == len(pair.after_frames) == 1
    assert min(len(pair.before), len(pair.after)) > 30_000


@pytest.mark.slow
@pytest.mark.parametrize("scene", FRAMES)
def test_every_frame_point_is_one_of_its_frame(scene: str) -> None:
    pair = pair_of(scene)
    everything = {point.tobytes() for point in frame_points(pair.after_frames[0])}
    assert all(point.tobytes() in everything for point in pair.after)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits() -> None:
    first, again, other = simulate_pair("moved", 5), simulate_pair("moved", 5), simulate_pair("moved", 6)
    for name in ("before", "after", "before_objects", "after_objects", "hidden_before", "hidden_after"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.after_frames[0].pose, again.after_frames[0].pose)
    assert first.before.shape != other.before.shape or (first.before != other.before).any()
    before, after = pair_of("unchanged").before_frames[0], pair_of("unchanged").after_frames[0]
    assert (before.pose != after.pose).any()


def test_as_in_the_paper_objects_only_appear() -> None:
    for scene in PAPER:
        before, after = scene_worlds(scene)
        assert set(changed_names(before, after)) == set(after.names) - set(before.names)
        assert set(before.names) <= set(after.names)
    assert not pair_of("cargo_bag").disappeared.any()
    assert not pair_of("unchanged").appeared.any()
    assert not pair_of("unchanged").disappeared.any()


def test_the_docked_robot_touches_its_dock_and_the_crate_the_bag() -> None:
    docked = scene_worlds("three_objects")[1]
    body = np.array([solid.corners for thing, solid in docked.solids if docked.things[thing].name == "astrobee"])
    assert Scene((docked["dock"],)).nearest(body.reshape(-1, 3))[0].min() < 0.03
    touching = scene_worlds("touching")[1]
    crate = np.array([solid.corners for thing, solid in touching.solids if touching.things[thing].name == "crate"])
    assert Scene((touching["cargo bag"],)).nearest(crate.reshape(-1, 3))[0].min() < 0.03


@pytest.mark.parametrize("scene", SCENES)
def test_objects_stand_clear_of_the_cameras_and_of_each_other(scene: str) -> None:
    station = RECIPES[scene].station
    poses = [camera_pose(*station)] if station else survey_path()
    for world in scene_worlds(scene):
        centres = np.array([pose[:3, 3] for pose in poses])
        assert world.nearest(centres)[0].min() > 0.08
        assert not any(solid.contains(centres).any() for _, solid in world.solids)
        robots = np.array([[x, y, ROBOT_HEIGHT] for x, y in ([station[:2]] if station else STATIONS)])
        assert world.nearest(robots)[0].min() > 0.2  # the robot is 0.32 m wide
        changed = [thing for thing in world.things if thing.name in changed_names(*scene_worlds(scene))]
        for thing in changed:
            corners = np.concatenate([part.placed(thing.pose).corners for part in thing.parts])
            others = [part.placed(other.pose) for other in world.things if other is not thing for part in other.parts]
            assert not any((other.contains(corners) & (other.distance(corners) > 0.005)).any() for other in others)


@pytest.mark.parametrize(
    ("scene", "seed"), [("cargo", 0), ("", 0), (None, 0), ("cargo_bag", -1), ("cargo_bag", 0.5), ("cargo_bag", True)]
)
def test_what_cannot_be_simulated_is_refused(scene: str, seed: int) -> None:
    with pytest.raises(ValueError, match="three_objects" if scene != "cargo_bag" else "seed"):
        simulate_pair(scene, seed)


def test_without_errors_clouds_lie_on_the_surfaces_and_the_object_is_the_one_that_was_met() -> None:
    pair = pair_of("astrobee", 0, False, False)
    world, camera = scene_worlds("astrobee")[1], DepthCamera.perfect()
    assert world.nearest(pair.after)[0].max() < 1e-9
    view = camera.view(world, pair.after_frames[0].pose)
    points = frame_points(pair.after_frames[0])
    met = (view.thing == world.names.index("astrobee"))[np.isfinite(view.depth)]
    kept = ((points >= SEARCH_BOUNDARY[0]) & (points <= SEARCH_BOUNDARY[1])).all(axis=1)
    assert (met[kept] != pair.appeared).mean() < 1e-3  # where the carriage stands on the table both are as near


@pytest.mark.slow
def test_the_pose_error_is_rigid_and_can_be_switched_off() -> None:
    wrong, right = pair_of("cargo_bag", 0), pair_of("cargo_bag", 0, True, False)
    np.testing.assert_array_equal(wrong.after_frames[0].depth, right.after_frames[0].depth)
    offset = wrong.after_frames[0].pose @ inverse(right.after_frames[0].pose)
    moved = transform(offset, frame_points(right.after_frames[0]))
    np.testing.assert_allclose(moved, frame_points(wrong.after_frames[0]), atol=1e-9)
    assert 0 < np.linalg.norm(wrong.after_frames[0].pose[:3, 3] - right.after_frames[0].pose[:3, 3]) < 0.05


def test_numbers_of_objects_are_those_of_the_nearest_solid() -> None:
    world = scene_worlds("mixed")[1]
    points = np.random.default_rng(0).uniform([-1, -1, 0], [1, 1, 1.5], (400, 3))
    names = ("crate 2", "astrobee")
    each = np.array([solid.distance(points) for _, solid in world.solids])
    nearest = [world.names[world.solids[k][0]] for k in each.argmin(axis=0)]
    expected = [names.index(name) + 1 if name in names else 0 for name in nearest]
    np.testing.assert_array_equal(object_numbers(points, world, names), expected)
    assert set(expected) == {0, 1, 2}


@pytest.mark.slow
def test_hidden_is_what_no_free_line_of_sight_reaches() -> None:
    world, camera = scene_worlds("three_objects")[1], DepthCamera.perfect()
    poses = survey_path()[4::5]
    rng = np.random.default_rng(1)
    wall = np.column_stack([np.full(200, -0.995), rng.uniform(-0.9, 0.9, 200), rng.uniform(0, 1.6, 200)])
    floor = np.column_stack([rng.uniform(-0.9, 0.9, (100, 2)), np.zeros(100)])
    points = np.concatenate([wall, floor])
    expected = np.zeros(len(points), dtype=bool)
    for pose in poses:
        (column, row), depth = project(transform(inverse(pose), points), camera.intrinsics)
        inside = (column > -0.5) & (column < 223.5) & (row > -0.5) & (row < 171.5) & (depth > 0.2) & (depth < 4)
        for i in np.flatnonzero(inside):
            ray = points[i] - pose[:3, 3]
            reach = np.linalg.norm(ray)
            steps = np.arange(0, reach - 0.03, 0.005) / reach
            line = pose[:3, 3] + steps[:, None] * ray
            expected[i] |= not any(solid.contains(line).any() for _, solid in world.solids)
    seen = visible(points, world, poses, camera)
    assert 0.1 < seen.mean() < 0.9
    assert (seen == expected).mean() > 0.97  # `visible` has a tolerance, and a ray may graze a corner between two steps
    assert TOLERANCE < 0.03


def test_a_surface_too_slanted_to_answer_counts_as_hidden() -> None:
    slab = Scene((Thing("slab", (Box((4.0, 0.1, 8.0), pose=pose_at(0, 0.15, 4.5)),), np.eye(4)),))
    points = np.array([[0.0, 0.1, 0.8], [0.0, 0.1, 3.5]])  # at 83 and at 88 degrees
    assert visible(points, slab, [np.eye(4)], DepthCamera()).tolist() == [True, False]


def small_survey(noise: bool) -> tuple[Scene, list[DepthFrame]]:
    """A box before a wall, seen from eight places."""
    things = (Box((2.0, 0.02, 1.6), pose=pose_at(0, -0.01, 0.7)), Box((0.3, 0.3, 0.3), pose=pose_at(0, 0.3, 0.7)))
    scene = Scene((Thing("all", things, np.eye(4)),))
    camera = DepthCamera() if noise else DepthCamera.perfect()
    rng = np.random.default_rng(0)
    poses = [camera_pose(x, 1.6, np.radians(-90) + x / 2) for x in np.linspace(-0.5, 0.5, 8)]
    return scene, [DepthFrame(camera.capture(scene, pose, rng), pose, camera.intrinsics) for pose in poses]


BOUNDARY = ((-0.6, -0.1, 0.3), (0.6, 0.6, 1.1))


def test_a_noise_free_map_lies_within_a_voxel_of_the_surfaces() -> None:
    scene, frames = small_survey(noise=False)
    fused = fuse(frames, BOUNDARY)
    assert scene.nearest(fused.points)[0].max() < VOXEL
    assert len(fused.points) > 8_000
    front = np.abs(fused.points[:, 1] - 0.45) < VOXEL
    assert np.ptp(fused.points[front, 0]) > 0.25  # the box's face is there


def test_a_map_is_less_noisy_than_a_frame() -> None:
    _, frames = small_survey(noise=True)

    def spread(points: np.ndarray) -> float:
        bare = (np.abs(points[:, 0]) > 0.3) & (np.abs(points) < [0.6, 0.1, 1.1]).all(axis=1) & (points[:, 2] > 0.3)
        return float(np.sqrt((points[bare, 1] ** 2).mean()))

    single = np.mean([spread(frame_points(frame)) for frame in frames])
    fused = fuse(frames, BOUNDARY)
    assert spread(fused.points) < 0.6 * single
    assert (fused.weights > 0).all()
    assert fused.weights.shape == (len(fused.points),)


def test_the_signed_distance_to_a_plane_is_exact() -> None:
    pose, camera = camera_pose(0.2, 1.5, np.radians(-75)), DepthCamera.perfect()
    scene = Scene((Thing("wall", (Box((9.0, 0.02, 9.0), pose=pose_at(0, -0.01, 0.7)),), np.eye(4)),))
    frame = DepthFrame(camera.capture(scene, pose, 0), pose, camera.intrinsics)
    rng = np.random.default_rng(0)
    world = np.column_stack([rng.uniform(-0.1, 0.1, 500), rng.uniform(-0.03, 0.03, 500), rng.uniform(0.6, 0.8, 500)])
    distance, weight = signed_distance(frame, transform(inverse(pose), world), 0.05)
    on_axis = np.cos(np.radians(15))  # the distance along the optical axis, shortened by the slant there
    slant = frame_points(frame)[:, 1]
    assert np.abs(slant).max() < 1e-9
    assert (weight > 0).all()
    np.testing.assert_array_equal(np.sign(distance), np.sign(world[:, 1]))
    np.testing.assert_allclose(distance, world[:, 1], atol=0.004)
    surface = np.column_stack([world[:, 0], np.zeros(500), world[:, 2]])
    assert np.abs(signed_distance(frame, transform(inverse(pose), surface), 0.05)[0]).max() < 1e-9
    cosine = surface_squares(frame)[1, :-1].reshape(171, 223)[87, 117]
    assert cosine == pytest.approx(on_axis, abs=0.01)


def test_nothing_is_learnt_next_to_edges() -> None:
    depth = np.full((20, 20), 2.0)
    depth[:, 10:] = 1.5
    trust = surface_squares(DepthFrame(depth, np.eye(4), (100.0, 100.0, 10.0, 10.0)))[0, :-1].reshape(19, 19)
    assert (trust[:, 8:11] == 0).all()
    assert (trust[:, :8] > 0).all()
    assert (trust[:, 11:] > 0).all()


def test_free_space_is_what_rays_went_through() -> None:
    frame = DepthFrame(np.full((172, 224), 2.0), np.eye(4), (188.0, 186.0, 112.0, 86.0))
    centres = np.array([[0, 0, 1.0], [0, 0, 1.9], [0, 0, 2.0], [0, 0, 3.0], [3.0, 0, 1.0], [0, 0, -1.0]])
    assert seen_through(frame, centres, 0.05).tolist() == [True, True, False, False, False, False]
    scene, frames = small_survey(noise=False)
    fused = fuse(frames, BOUNDARY)
    block = np.argwhere(fused.free >= len(frames) // 2) * fused.block_size + fused.lower + fused.block_size / 2
    assert len(block) > 100
    assert not any(solid.contains(block).any() for _, solid in scene.solids)


def test_progress_is_shown_when_asked_for(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TQDM_DISABLE", "0")
    _, frames = small_survey(noise=False)
    fuse(frames[:2], BOUNDARY)
    assert capsys.readouterr().err == ""
    fuse(frames[:2], BOUNDARY, progress=True)
    assert "fusing" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("scene", MAPS)
def test_maps_carry_truth_for_every_point(scene: str) -> None:
    pair = pair_of(scene)
    check_pair(pair)
    assert min(len(pair.before), len(pair.after)) >= 100_000
    if scene in (*PAPER, "unchanged_map"):
        assert not pair.disappeared.any()
        assert pair.appeared.any() == (scene != "unchanged_map")


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["two_objects", "mixed"])
def test_noise_free_maps_lie_within_a_voxel_of_the_surfaces(scene: str) -> None:
    pair = pair_of(scene, 0, False, False)
    for world, points in zip(scene_worlds(scene), (pair.before, pair.after), strict=True):
        assert len(points) >= 100_000
        assert world.nearest(points)[0].max() < VOXEL


@pytest.mark.slow
def test_the_map_of_the_lab_is_less_noisy_than_its_frames() -> None:
    pair = pair_of("unchanged_map")
    world = scene_worlds("unchanged_map")[0]
    points = np.concatenate([frame_points(frame) for frame in pair.before_frames[3::7]])
    points = points[((points >= SEARCH_BOUNDARY[0]) & (points <= SEARCH_BOUNDARY[1])).all(axis=1)]
    single, fused = (np.sqrt((world.nearest(cloud)[0] ** 2).mean()) for cloud in (points, pair.before))
    assert fused < 0.7 * single


@pytest.mark.slow
def test_a_map_is_bit_identical_for_a_seed() -> None:
    again = simulate_pair("unchanged_map", 0)
    np.testing.assert_array_equal(again.before, pair_of("unchanged_map").before)
    np.testing.assert_array_equal(again.hidden_after, pair_of("unchanged_map").hidden_after)


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "seconds"), [("cargo_bag", 1.0), ("mixed", 30.0)])
def test_pairs_are_made_in_time(scene: str, seconds: float) -> None:
    scene_worlds(scene)
    start = time.process_time()
    simulate_pair(scene, 1)
    assert time.process_time() - start < seconds


def test_surveys_return_to_a_station_nearly_never_exactly() -> None:
    pose = survey_path()[0]
    moved = perturbed(pose, (0.02, 0.02), np.random.default_rng(0), level=True)
    assert 0 < np.linalg.norm(moved[:3, 3] - pose[:3, 3]) < 0.1
    assert moved[2, 3] == pose[2, 3]
