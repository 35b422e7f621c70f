"""What a before/after pair carries: two clouds, the truth for every point, and the frames they came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class DepthFrame:
    """One image of a depth camera; the camera looks along +z, x to the right, y down.

    Attributes
    ----------
    depth : (H, W) metres along the optical axis, NaN where nothing came back.
    pose : (4, 4) camera to world, as estimated by the robot.
    intrinsics : (fx, fy, cx, cy) pixels.
    """

    depth: Floats
    pose: Floats
    intrinsics: tuple[float, float, float, float]


@dataclass(frozen=True)
class ScenePair:
    """Two scans of one place, with the truth.

    Attributes
    ----------
    name, description : the key of the scene, and one sentence on what changed.
    before, after : (N_before, 3), (N_after, 3) points in metres.
    before_objects, after_objects : (N,) int, number (1, 2, ...) of the changed object a point belongs to, 0 for none.
    object_names : name of changed object 1, 2, ...
    hidden_before, hidden_after : (N,) bool, unchanged surface that the other scan could not see.
    before_frames, after_frames : the depth images behind each cloud, with their estimated poses.
    """

    name: str
    description: str
    before: Floats
    after: Floats
    before_objects: NDArray[np.int64]
    after_objects: NDArray[np.int64]
    object_names: tuple[str, ...]
    hidden_before: Bools
    hidden_after: Bools
    before_frames: tuple[DepthFrame, ...]
    after_frames: tuple[DepthFrame, ...]

    @property
    def disappeared(self) -> Bools:
        """(N_before,) bool: points of `before` on objects that were moved or taken away."""
        return self.before_objects > 0

    @property
    def appeared(self) -> Bools:
        """(N_after,) bool: points of `after` on objects that were moved or added."""
        return self.after_objects > 0
