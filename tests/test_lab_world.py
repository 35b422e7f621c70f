"""The lab's solids and scenes: rays and distances against the inequalities that define a solid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from gmmcd_teach.lab.granite import granite_lab
from gmmcd_teach.lab.shapes import Box, Cylinder, Solid, axis_along, inverse, pose_at, transform
from gmmcd_teach.lab.survey import camera_pose, perturbed, rotation
from gmmcd_teach.lab.world import Scene, Thing


def tilted(rng: np.random.Generator) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(rng.normal(size=3)), rng.normal([0, 0, 3], 0.3)
    return pose


@pytest.fixture(params=range(6))
def solid(request: pytest.FixtureRequest) -> Solid:
    rng = np.random.default_rng(request.param)
    if request.param % 2:
        return Cylinder(*rng.uniform(0.3, 1.5, 2), pose=tilted(rng))
    return Box(tuple(rng.uniform(0.3, 1.5, 3)), pose=tilted(rng))


def test_rays_enter_where_the_inside_begins(solid: Solid) -> None:
    rng = np.random.default_rng(1)
    directions = np.column_stack([rng.uniform(-0.5, 0.5, (300, 2)), np.ones(300)])
    enter = solid.enter(np.zeros(3), directions.T)
    steps = np.linspace(0, 6, 3001)
    for ray, start in zip(directions, enter, strict=True):
        inside = solid.contains(steps[:, None] * ray)
        if not np.isfinite(start):
            assert inside.sum() <= 1  # it may still cut a corner between two steps
            continue
        assert solid.distance(start * ray[None])[0] < 1e-12
        assert not inside[steps < start - 1e-9].any()
        if inside.any():
            assert steps[inside][0] - start < 0.002 + 1e-9


def test_the_normal_points_out_of_the_face_that_was_met(solid: Solid) -> None:
    rng = np.random.default_rng(2)
    directions = np.column_stack([rng.uniform(-0.3, 0.3, (500, 2)), np.ones(500)])
    enter = solid.enter(np.zeros(3), directions.T)
    met = np.isfinite(enter)
    points = enter[met, None] * directions[met]
    face, normal = solid.surface(points)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1)
    assert ((normal * directions[met]).sum(axis=1) < 0).all()
    assert not solid.contains(points + 1e-6 * normal).any()
    assert solid.contains(points - 1e-6 * normal).mean() > 0.99  # all but points that sit on a rim
    assert len(np.unique(face)) >= 2


def test_distance_to_a_solid_is_the_least_distance_to_its_points(solid: Solid) -> None:
    rng = np.random.default_rng(3)
    points = solid.pose[:3, 3] + rng.normal(0, 1.2, (12, 3))
    points = points[~solid.contains(points)]
    size = solid.half_extent

    def nearest(point: np.ndarray) -> float:
        own = transform(inverse(solid.pose), point[None])[0]
        limits = [(-h, h) for h in size]
        round_wall = [{"type": "ineq", "fun": lambda x: size[0] ** 2 - x[0] ** 2 - x[1] ** 2}]
        constraints = round_wall if isinstance(solid, Cylinder) else []
        found = minimize(
            lambda x: ((x - own) ** 2).sum(), np.zeros(3), bounds=limits, constraints=constraints, method="SLSQP"
        )
        return float(np.sqrt(found.fun))

    np.testing.assert_allclose(solid.distance(points), [nearest(point) for point in points], atol=1e-4)


def test_distance_inside_is_to_the_nearest_face() -> None:
    assert Box((2, 4, 6)).distance(np.array([[0.0, 0, 0], [0.9, 0, 0], [0, 0, 2.8]])) == pytest.approx([1, 0.1, 0.2])


def test_an_axis_is_laid_where_it_is_said_to_lie() -> None:
    for axis, along in zip("xyz", np.eye(3), strict=True):
        np.testing.assert_array_equal(axis_along(axis)[:3, :3] @ [0, 0, 1], along)
        assert np.linalg.det(axis_along(axis)[:3, :3]) == pytest.approx(1)


def test_a_scene_meets_what_its_solids_meet_one_by_one() -> None:
    scene, pose = granite_lab(), perturbed(camera_pose(0.5, 0.4, -2.5), (0.1, 0.5), np.random.default_rng(4))
    rays = np.column_stack([np.random.default_rng(5).uniform(-0.6, 0.6, (4000, 2)), np.ones(4000)])
    hits = scene.cast(pose, rays)
    each = np.array([solid.enter(pose[:3, 3], pose[:3, :3] @ rays.T) for _, solid in scene.solids])
    np.testing.assert_allclose(hits.depth, each.min(axis=0), rtol=1e-12)
    owner = np.array([thing for thing, _ in scene.solids])
    np.testing.assert_array_equal(hits.thing, np.where(np.isfinite(hits.depth), owner[each.argmin(axis=0)], -1))
    assert len(np.unique(hits.thing)) >= 3


def test_the_nearest_surface_is_the_nearest_of_all_solids() -> None:
    scene, points = granite_lab(), np.random.default_rng(6).uniform([-1, -1, 0], [1, 1, 2], (500, 3))
    distance, thing = scene.nearest(points)
    each = np.array([solid.distance(points) for _, solid in scene.solids])
    np.testing.assert_array_equal(distance, each.min(axis=0))
    np.testing.assert_array_equal(thing, np.array([owner for owner, _ in scene.solids])[each.argmin(axis=0)])


def test_things_come_move_and_go_and_the_old_scene_stays() -> None:
    empty = granite_lab()
    thing = Thing("parcel", (Box((0.2, 0.2, 0.2)),), pose_at(0, 0, 0.1))
    full = empty.with_object(thing)
    moved = full.moved("parcel", pose_at(0.5, 0, 0.1))
    assert "parcel" not in empty.names
    assert full["parcel"] is thing
    assert moved["parcel"].pose[0, 3] == 0.5
    assert full["parcel"].pose[0, 3] == 0
    assert moved.without("parcel").names == empty.names
    with pytest.raises(ValueError, match="already"):
        full.with_object(thing)
    for change in (lambda: empty.without("parcel"), lambda: empty.moved("parcel", np.eye(4)), lambda: empty["parcel"]):
        with pytest.raises(ValueError, match=r"no object named 'parcel'.*dock"):
            change()


def test_nothing_is_met_in_an_empty_scene() -> None:
    hits = Scene().cast(np.eye(4), np.array([[0.0, 0, 1]]))
    assert hits.depth.tolist() == [np.inf]
    assert hits.thing.tolist() == [-1]


def test_rotations_are_those_of_scipy() -> None:
    from scipy.spatial.transform import Rotation

    for vector in np.random.default_rng(7).normal(size=(20, 3)):
        np.testing.assert_allclose(rotation(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(rotation(np.zeros(3)), np.eye(3))


def test_a_perturbation_has_the_size_that_is_asked_for() -> None:
    rng = np.random.default_rng(8)
    for level in (False, True):
        moved = np.array([perturbed(np.eye(4), (0.01, 0.02), rng, level=level) for _ in range(10000)])
        offset = np.sqrt((moved[:, :3, 3] ** 2).sum(axis=1).mean())
        angle = np.arccos(np.clip((np.trace(moved[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
        assert offset == pytest.approx(0.01, rel=0.03)
        assert np.sqrt((angle**2).mean()) == pytest.approx(0.02, rel=0.03)
        assert (np.abs(moved[:, 2, 3]).max() == 0) == level
