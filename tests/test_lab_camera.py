"""The depth camera: geometry to 1e-9 m, and each imperfection against the law that it is said to follow."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from gmmcd_teach.lab.camera import (
    NONE_RETURN,
    DepthCamera,
    axial_sigma,
    back_project,
    frame_pixels,
    frame_points,
    lateral_sigma,
    pixel_rays,
    return_probability,
)
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.lab.scenes import scene_worlds
from gmmcd_teach.lab.shapes import Box, pose_at
from gmmcd_teach.lab.survey import camera_pose, rotation, survey_path
from gmmcd_teach.lab.world import Scene, Thing


def wall(depth: float, angle: float) -> Scene:
    """A large thin wall across the optical axis at `depth`, turned by `angle` about the vertical of the image."""
    pose = pose_at(0, 0, depth)
    pose[:3, :3] = rotation(np.array([0, angle, 0]))
    front = Box((200.0, 200.0, 0.01), pose=pose_at(0, 0, 0.005))
    return Scene((Thing("wall", (front,), pose),))


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["cargo_bag", "three_objects"])
def test_a_perfect_frame_lies_on_the_surfaces(scene: str) -> None:
    world, camera = scene_worlds(scene)[1], DepthCamera.perfect()
    for pose in survey_path()[3::9]:
        frame = DepthFrame(camera.capture(world, pose, 0), pose, camera.intrinsics)
        assert world.nearest(frame_points(frame))[0].max() < 1e-9
        np.testing.assert_array_equal(frame.depth, camera.view(world, pose).depth)


def test_a_cloud_pushed_back_lands_on_its_own_pixels() -> None:
    camera, pose = DepthCamera(), camera_pose(0.1, 0.7, -1.4)
    frame = DepthFrame(camera.capture(scene_worlds("cargo_bag")[1], pose, 3), pose, camera.intrinsics)
    (column, row), depth = frame_pixels(frame, frame_points(frame))
    rows, columns = np.nonzero(np.isfinite(frame.depth))
    np.testing.assert_allclose(column, columns, atol=1e-9)
    np.testing.assert_allclose(row, rows, atol=1e-9)
    np.testing.assert_allclose(depth, frame.depth[rows, columns], atol=1e-12)
    assert len(depth) > 30_000


def test_the_field_of_view_is_that_of_the_sensor() -> None:
    rays = DepthCamera().rays()
    width = np.degrees(np.arctan(rays[0, -1, 0]) - np.arctan(rays[0, 0, 0]))
    height = np.degrees(np.arctan(rays[-1, 0, 1]) - np.arctan(rays[0, 0, 1]))
    assert (width, height) == (pytest.approx(61.5, abs=0.5), pytest.approx(49.3, abs=0.5))


@pytest.mark.slow
@pytest.mark.parametrize("depth", [0.5, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("angle", [0, 30, 60])
def test_noise_follows_the_stated_law(depth: float, angle: float) -> None:
    camera = DepthCamera()
    scene = wall(depth, np.radians(angle))
    true, incidence = (part[60:112, 75:150] for part in camera.view(scene, np.eye(4))[::3])
    measured = np.array([camera.capture(scene, np.eye(4), seed)[60:112, 75:150] for seed in range(9)])
    kept = np.isfinite(measured) & (true < 3.8)
    error = ((measured - true) / axial_sigma(true, incidence))[kept]
    assert len(error) >= 10_000
    assert error.std() == pytest.approx(1, rel=0.03)
    assert abs(error.mean()) < 4 / np.sqrt(len(error))


def test_the_law_itself_is_that_of_nguyen_and_others() -> None:
    z, angle = 2.0, np.radians(60)
    by_hand = 0.0012 + 0.0019 * 1.6**2 + 0.0001 / 2**0.5 * (np.pi / 3) ** 2 / (np.pi / 6) ** 2
    assert axial_sigma(np.array(z), np.array(angle)) == pytest.approx(by_hand)
    assert lateral_sigma(np.array(angle)) == pytest.approx(0.8 + 0.035 * 2)


@pytest.mark.parametrize("angle", [60, 74, 80, 86])
def test_slanted_surfaces_return_as_often_as_stated(angle: float) -> None:
    camera = DepthCamera(axial=False, lateral=False, flying=False)
    scene = wall(1.0, np.radians(angle))
    view = camera.view(scene, np.eye(4))
    seen = np.isfinite(view.depth)
    returned = np.array([np.isfinite(camera.capture(scene, np.eye(4), seed)) for seed in range(5)])
    expected = return_probability(view.incidence[seen])
    assert returned[:, seen].mean() == pytest.approx(expected.mean(), abs=0.01)
    assert not returned[:, seen & (view.incidence >= NONE_RETURN)].any()
    assert returned.sum() >= 10_000 or angle > 80


def test_lateral_noise_moves_outlines_by_the_stated_amount() -> None:
    """Each row looks across one edge; how often a column meets the block is a normal distribution function."""
    camera = DepthCamera((200.0, 1e6, 9.5, 6000.0), (12_000, 20), axial=False, flying=False, grazing=False)
    block = Box((10.0, 200.0, 0.1), pose=pose_at(-5.0 + 0.013, 0, 1.05))
    background = Box((200.0, 200.0, 0.1), pose=pose_at(0, 0, 1.55))
    depth = camera.capture(Scene((Thing("both", (block, background), np.eye(4)),)), np.eye(4), 0)
    edge = 9.5 + 200 * 0.013
    columns = np.arange(20)
    assert set(np.unique(depth.round(9))) == {1.0, 1.5}
    incidence = camera.view(Scene((Thing("both", (block, background), np.eye(4)),)), np.eye(4)).incidence[6000]
    chance = norm.cdf((edge - columns) / lateral_sigma(incidence))
    near = np.abs(columns - edge) < 3
    np.testing.assert_allclose((depth == 1.0).mean(axis=0)[near], chance[near], atol=0.02)


def test_a_flying_pixel_is_the_mean_of_its_sub_rays() -> None:
    camera = DepthCamera(axial=False, lateral=False, grazing=False)
    world, pose = scene_worlds("astrobee")[1], camera_pose(-0.6, 0.1, 0.0)
    view, depth = camera.view(world, pose), camera.capture(world, pose, 0)
    changed = np.argwhere(np.isfinite(depth) & (np.abs(depth - view.depth) > 0.05))
    assert len(changed) > 100
    for row, column in changed[::25]:
        steps = np.array([-1, 0, 1]) / 3
        rays = np.array([pixel_rays(column + i, row + j, camera.intrinsics) for j in steps for i in steps])
        hits, own = world.cast(pose, rays), pixel_rays(column, row, camera.intrinsics)
        each = []
        for ray, met, normal in zip(rays, hits.depth, hits.normal @ pose[:3, :3], strict=True):
            z = met * (normal @ ray) / (normal @ own) if np.isfinite(met) else np.inf
            if 0.2 <= z <= 4:
                each.append(z)
        assert depth[row, column] == pytest.approx(np.mean(each), abs=1e-9)


def test_only_outlines_differ_when_flying_pixels_are_on() -> None:
    camera = DepthCamera(axial=False, lateral=False, grazing=False)
    scene = wall(1.5, 0.5)
    np.testing.assert_array_equal(camera.capture(scene, np.eye(4), 0), camera.view(scene, np.eye(4)).depth)


def test_nothing_is_measured_out_of_range() -> None:
    for depth in (0.15, 4.2):
        assert np.isnan(DepthCamera.perfect().capture(wall(depth, 0), np.eye(4), 0)).all()
    assert np.isfinite(DepthCamera.perfect().capture(wall(3.9, 0), np.eye(4), 0)).all()


def test_the_same_seed_gives_the_same_image() -> None:
    camera, world, pose = DepthCamera(), scene_worlds("cargo_bag")[1], camera_pose(0, 0.8, -1.5)
    first, again, other = (camera.capture(world, pose, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.nanmax(np.abs(first - other)) > 0


def test_back_projection_is_the_pinhole_equation() -> None:
    depth = np.random.default_rng(0).uniform(1, 2, (4, 5))
    by_hand = [
        [(u - 2) / 10 * depth[v, u], (v - 3) / 20 * depth[v, u], depth[v, u]] for v in range(4) for u in range(5)
    ]
    np.testing.assert_allclose(back_project(depth, (10.0, 20.0, 2.0, 3.0)), by_hand)
