"""Where the robot stands when it looks, and how wrongly it knows that (chapter 1).

The robot glides on the table, so its camera stays level and at one height. Stand-ins, chosen here: the stations of the
survey, and how nearly the robot comes back to a station (2 cm, 1 degree). The size of the pose error, about 1 cm and
0.5 degrees a frame, stands for what the paper calls localisation uncertainty.
"""

from __future__ import annotations

import numpy as np

from gmmcd_teach.lab.granite import ROBOT_HEIGHT
from gmmcd_teach.lab.shapes import Floats

CAMERA_FORWARD, CAMERA_RIGHT, CAMERA_UP = 0.1328, 0.0362, 0.0826  # nasa/astrobee bsharp.config: HazCam on the robot
POSE_ERROR = (0.01, np.radians(0.5))  # root mean square offset in metres and radians, one draw a frame
REVISIT = (0.02, np.radians(1.0))  # the same, for coming back to a station
STATIONS = (
    (0.70, 0.82), (0.45, 0.82), (0.10, 0.80), (-0.26, 0.82), (0.60, 0.40), (0.10, 0.20), (0.50, -0.05), (-0.40, -0.20),
)  # fmt: skip  # x, y of the robot in metres, clear of every object
HEADINGS = np.radians([0, -30, -60, -90, -120, -150, -180])  # the walls at x = 1, y = -1, x = -1, and between them


def camera_pose(x: float, y: float, heading: float) -> Floats:
    """Pose (4, 4), camera to world, of the HazCam of a robot at (x, y) metres that faces `heading` (radians from +x).

    Examples
    --------
    >>> camera_pose(0, 0, 0)[:3, 2].round(6).tolist()
    [1.0, 0.0, 0.0]
    """
    forward = np.array([np.cos(heading), np.sin(heading), 0.0])
    right, down = np.array([forward[1], -forward[0], 0.0]), np.array([0.0, 0.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, down, forward], axis=1)
    pose[:3, 3] = [x, y, ROBOT_HEIGHT] + CAMERA_FORWARD * forward + CAMERA_RIGHT * right - CAMERA_UP * down
    return pose


def survey_path() -> list[Floats]:
    """Camera poses (4, 4) of a survey: from every station one look along each heading."""
    return [camera_pose(x, y, heading) for x, y in STATIONS for heading in HEADINGS]


def perturbed(pose: Floats, size: tuple[float, float], rng: np.random.Generator, *, level: bool = False) -> Floats:
    """A pose (4, 4) moved by a random offset whose root mean square is `size` (metres, radians).

    The camera turns about its own centre, about any axis; with `level` it slides and turns on the table only.
    """
    free = np.array([1.0, 1.0, 0.0]) if level else np.ones(3)
    upright = np.array([0.0, 0.0, 1.0]) if level else np.ones(3)
    offset = size[0] / np.sqrt(free.sum()) * free * rng.standard_normal(3)
    turn = size[1] / np.sqrt(upright.sum()) * upright * rng.standard_normal(3)
    moved = pose.copy()
    moved[:3, :3] = rotation(turn) @ pose[:3, :3]
    moved[:3, 3] += offset
    return moved


def rotation(vector: Floats) -> Floats:
    """Rotation (3, 3) about the axis of `vector` (3,) by its length in radians (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
