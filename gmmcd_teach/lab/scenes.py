"""The scenes of the book: what stands where before and after, scanned into a pair of clouds (chapter 1).

As in the paper, one pair is either two single frames taken from nearly the same place, or two maps fused from a survey,
and in the paper's four scenes objects only appear. Where exactly the objects stand is chosen here; the paper gives no
coordinates. Clouds are cropped to the lab (`SEARCH_BOUNDARY`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from gmmcd_teach.lab.camera import DepthCamera, frame_points
from gmmcd_teach.lab.fusion import fuse
from gmmcd_teach.lab.granite import DOCK, DOCK_PLACE, SEARCH_BOUNDARY, astrobee, cargo_bag, crate, granite_lab
from gmmcd_teach.lab.pair import DepthFrame, ScenePair
from gmmcd_teach.lab.shapes import Floats, inverse, pose_at, transform
from gmmcd_teach.lab.survey import POSE_ERROR, REVISIT, camera_pose, perturbed, survey_path
from gmmcd_teach.lab.truth import changed_names, object_numbers, visible
from gmmcd_teach.lab.world import Scene, Thing
from gmmcd_teach.progress import progress_bar

EAST, NORTH, WEST, SOUTH = np.radians([0, 90, 180, -90])  # towards +x, +y, -x, -y


@dataclass(frozen=True)
class Recipe:
    """What stands in the lab before and after; a single frame also has the robot's x, y (m) and heading (radians).

    A thing that is in both tuples has stayed; a name that is in both at different places has moved.
    """

    description: str
    before: tuple[Thing, ...] = ()
    after: tuple[Thing, ...] = ()
    station: tuple[float, float, float] | None = None


_BAG_SOUTH = cargo_bag(at=pose_at(-0.35, -0.80, 0, NORTH))
_BAG_WEST = cargo_bag(at=pose_at(-0.80, -0.68, 0, EAST))
_CRATE_EAST = crate(at=pose_at(0.76, -0.58, 0, EAST))
_CRATE_SOUTH = crate(at=pose_at(0.40, -0.77, 0, NORTH))
_ASTROBEE_EAST = astrobee(at=pose_at(0.78, 0.25, 0, WEST))
_ASTROBEE_WEST = astrobee(at=pose_at(-0.80, 0.86, 0, EAST))
_ASTROBEE_DOCKED = astrobee(at=pose_at(DOCK_PLACE[0] + DOCK[0] / 2 + 0.18, DOCK_PLACE[1] + DOCK[1] / 4, 0, EAST))
_TO_SOUTH, _TO_EAST = (0.05, 0.80, SOUTH), (-0.50, 0.10, EAST)

RECIPES = {
    "cargo_bag": Recipe("One frame: a cargo bag appears by the far wall.", (), (_BAG_SOUTH,), _TO_SOUTH),
    "astrobee": Recipe("One frame: a second Astrobee appears by the handrail.", (), (_ASTROBEE_EAST,), _TO_EAST),
    "two_objects": Recipe(
        "Map: an Astrobee and a cargo bag appear along the wall that holds the dock.", (), (_ASTROBEE_WEST, _BAG_WEST)
    ),
    "three_objects": Recipe(
        "Map: a crate, a cargo bag and an Astrobee on its dock appear, each by a wall of its own.",
        (),
        (_CRATE_EAST, _BAG_SOUTH, _ASTROBEE_DOCKED),
    ),
    "unchanged": Recipe("One frame: nothing changes.", station=_TO_SOUTH),
    "unchanged_map": Recipe("Map: nothing changes."),
    "mixed": Recipe(
        "Map: a bag and a crate go; another bag, another crate and an Astrobee on its dock come.",
        (_BAG_WEST, _CRATE_SOUTH),
        (replace(_BAG_SOUTH, name="cargo bag 2"), replace(_CRATE_EAST, name="crate 2"), _ASTROBEE_DOCKED),
    ),
    "mixed_frame": Recipe("One frame: a bag goes, a crate comes.", (_BAG_SOUTH,), (_CRATE_SOUTH,), _TO_SOUTH),
    "moved": Recipe(
        "One frame: a cargo bag moves along the wall.",
        (_BAG_SOUTH,),
        (replace(_BAG_SOUTH, pose=pose_at(0.35, -0.78, 0, NORTH + 0.2)),),
        _TO_SOUTH,
    ),
    "replaced": Recipe(
        "One frame: a crate stands where a cargo bag stood.",
        (_BAG_SOUTH,),
        (replace(_CRATE_SOUTH, pose=pose_at(-0.35, -0.78, 0, NORTH)),),
        _TO_SOUTH,
    ),
    "touching": Recipe(
        "One frame: a crate appears that touches a cargo bag, which stays.",
        (_BAG_SOUTH,),
        (_BAG_SOUTH, replace(_CRATE_SOUTH, pose=pose_at(0.1075, -0.78, 0, NORTH))),
        _TO_SOUTH,
    ),
    "rearranged": Recipe(
        "Map: a cargo bag moves from one wall to another, a crate stays, an Astrobee appears on its dock.",
        (_BAG_WEST, _CRATE_EAST),
        (_CRATE_EAST, replace(_BAG_WEST, pose=_BAG_SOUTH.pose), _ASTROBEE_DOCKED),
    ),
}
SCENES = tuple(RECIPES)


@cache
def _lab() -> Scene:
    return granite_lab()


def scene_worlds(scene: str) -> tuple[Scene, Scene]:
    """The two worlds, before and after, of a scene named in `SCENES` (ValueError for any other name).

    Examples
    --------
    >>> before, after = scene_worlds("cargo_bag")
    >>> set(after.names) - set(before.names)
    {'cargo bag'}
    """
    recipe = _recipe(scene)
    return Scene((*_lab().things, *recipe.before)), Scene((*_lab().things, *recipe.after))


def simulate_pair(
    scene: str, seed: int = 0, *, noise: bool = True, pose_error: bool = True, progress: bool = False
) -> ScenePair:
    """Scan a scene of the simulated Granite Lab before and after its change.

    Parameters
    ----------
    scene : one of `SCENES`; single frames take well under a second, maps some ten seconds.
    seed : the same seed gives the same bits.
    noise : False for a perfect camera.
    pose_error : False for a robot that knows exactly where it is.
    progress : show progress bars (maps only).

    Raises
    ------
    ValueError
        No scene of that name, or a negative seed.

    Examples
    --------
    >>> pair = simulate_pair("cargo_bag", seed=1)
    >>> pair.object_names, bool(pair.appeared.any()), bool(pair.disappeared.any())
    (('cargo bag',), True, False)
    """
    recipe = _recipe(scene)
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise ValueError(f"seed is {seed!r}; it must be a whole number, 0 or more")
    worlds = scene_worlds(scene)
    rng = np.random.default_rng([seed, *scene.encode()])
    path = [camera_pose(*recipe.station)] if recipe.station else survey_path()
    poses = [[perturbed(pose, REVISIT, rng, level=True) for pose in path] for _ in worlds]
    estimates = [[perturbed(pose, POSE_ERROR, rng) for pose in visit] for visit in poses]
    camera = DepthCamera() if noise else DepthCamera.perfect()
    before, after = (
        _scan(world, visit, believed if pose_error else visit, camera, rng, progress and recipe.station is None)
        for world, visit, believed in zip(worlds, poses, estimates, strict=True)
    )
    names = changed_names(*worlds)
    numbers = [object_numbers(scan.true_points, scan.world, names) for scan in (before, after)]
    hidden = [
        (number == 0) & ~visible(scan.true_points, other.world, other.poses, camera)
        for scan, other, number in ((before, after, numbers[0]), (after, before, numbers[1]))
    ]
    return ScenePair(
        name=scene,
        description=recipe.description,
        before=before.points,
        after=after.points,
        before_objects=numbers[0],
        after_objects=numbers[1],
        object_names=names,
        hidden_before=hidden[0],
        hidden_after=hidden[1],
        before_frames=before.frames,
        after_frames=after.frames,
    )


class _Scan(NamedTuple):
    world: Scene
    poses: list[Floats]  # where the camera truly was
    frames: tuple[DepthFrame, ...]
    points: Floats  # where the robot believes the points are
    true_points: Floats  # where they are, noise included; for a map the same as `points`


def _scan(
    world: Scene,
    poses: list[Floats],
    believed: list[Floats],
    camera: DepthCamera,
    rng: np.random.Generator,
    progress: bool,
) -> _Scan:
    frames = tuple(
        DepthFrame(camera.capture(world, pose, rng), estimate, camera.intrinsics)
        for pose, estimate in zip(
            progress_bar(poses, desc="scanning", unit="frame", shown=progress), believed, strict=True
        )
    )
    if len(frames) > 1:
        points = fuse(frames, SEARCH_BOUNDARY, progress=progress).points
        return _Scan(world, poses, frames, points, points)
    points = frame_points(frames[0])
    points = points[((points >= SEARCH_BOUNDARY[0]) & (points <= SEARCH_BOUNDARY[1])).all(axis=1)]
    return _Scan(world, poses, frames, points, transform(poses[0] @ inverse(believed[0]), points))


def _recipe(scene: str) -> Recipe:
    if scene not in RECIPES:
        raise ValueError(f"no scene named {scene!r}; there are: {', '.join(SCENES)}")
    return RECIPES[scene]
