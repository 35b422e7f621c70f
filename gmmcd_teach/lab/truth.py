"""What is true of every point of a scan, from the geometry of the scene alone (chapter 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gmmcd_teach.lab.camera import FARTHEST, NEAREST, NONE_RETURN, DepthCamera, project
from gmmcd_teach.lab.pair import Bools
from gmmcd_teach.lab.shapes import Floats, Ints, inverse, transform
from gmmcd_teach.lab.world import Scene

TOLERANCE = 0.02  # metres: a point this close behind a surface counts as being on it


def changed_names(before: Scene, after: Scene) -> tuple[str, ...]:
    """Names of things that are in one scene only, or in both at different places."""
    changed = [thing.name for thing in before.things if thing not in after.things]
    return (
        *changed,
        *(thing.name for thing in after.things if thing not in before.things and thing.name not in changed),
    )


def object_numbers(points: Floats, scene: Scene, names: Sequence[str]) -> Ints:
    """Number (N,) in `names` (1, 2, ...) of the thing whose surface is nearest to points (N, 3), 0 if not named."""
    number = np.array([names.index(name) + 1 if name in names else 0 for name in scene.names], dtype=np.int64)
    return number[scene.nearest(points)[1]]


def visible(points: Floats, scene: Scene, poses: Sequence[Floats], camera: DepthCamera) -> Bools:
    """Which points (N, 3) some camera at one of the true `poses` (4, 4) could have measured in `scene`.

    A camera could if the point is inside its image and range, if no surface stands in the way by more than `TOLERANCE`
    (measured along that surface's normal), and if the surface there is not too slanted to send light back.
    """
    seen = np.zeros(len(points), dtype=bool)
    height, width = camera.shape
    for pose in poses:
        waiting = np.flatnonzero(~seen)
        (column, row), depth = project(transform(inverse(pose), points[waiting]), camera.intrinsics)
        inside = (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
        measurable = inside & (depth >= NEAREST) & (depth <= FARTHEST)
        tried, reach = waiting[measurable], depth[measurable]
        rays = transform(inverse(pose), points[tried]) / reach[:, None]
        hits = scene.cast(pose, rays)
        cosine = -(hits.normal @ pose[:3, :3] * rays).sum(axis=1)  # times the ray's length
        met = np.isfinite(hits.depth)
        stopped = (reach - np.where(met, hits.depth, 0)) * cosine > TOLERANCE
        slanted = cosine < np.cos(NONE_RETURN) * np.linalg.norm(rays, axis=1)
        seen[tried[met & ~stopped & ~slanted]] = True
    return seen
