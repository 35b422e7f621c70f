"""Bring two scans together before they are compared, by point-to-plane ICP (chapter 14)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gmmcd_teach.beyond.surface import nearest, point_spacing, surface_of
from gmmcd_teach.clouds import Floats, check_points
from gmmcd_teach.starts import is_above_zero

WEAKEST = 1e-3  # directions in which the planes hold the cloud less than this, beside the best held one, are left alone


def align(
    moving: ArrayLike,
    fixed: ArrayLike,
    *,
    max_distance: float = 0.1,
    leaf_size: float | None = None,
    max_iter: int = 50,
) -> Floats:
    """Find the rigid motion that lays one cloud on another: point-to-plane ICP (Chen & Medioni 1992).

    Each step pairs every point with the nearest fixed one and makes the distances to its tangent plane small, by
    linearised least squares. Tukey's biweight, scaled by the median distance, leaves out what has changed. In
    directions that no surface holds (along a lone wall) nothing moves.

    Parameters
    ----------
    moving, fixed : (N, 3), (M, 3) metres.
    max_distance : metres, pairs farther apart are left out.
    leaf_size : metres, both clouds are thinned to cells of this size; None takes three times the spacing of points.
    max_iter : most steps.

    Returns
    -------
    (4, 4) the motion: `moving @ motion[:3, :3].T + motion[:3, 3]` lies on `fixed`.

    Raises
    ------
    CloudError
        A cloud cannot be used.
    ValueError
        An option is not a positive number.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> box = rng.uniform(0, 1, (3000, 3))
    >>> box[np.arange(3000), np.arange(3000) % 3] = 0.0
    >>> align(box + [0.02, 0, -0.03], box)[:3, 3].round(3) + 0.0
    array([-0.02,  0.  ,  0.03])
    """
    for name, value in (("max_distance", max_distance), ("leaf_size", leaf_size), ("max_iter", max_iter)):
        given = value is not None or name != "leaf_size"
        if given and not is_above_zero(value):
            raise ValueError(f"{name} = {value!r}; expected a positive number")
    start, goal = check_points(moving, "moving", dimensions=(3,)), check_points(fixed, "fixed", dimensions=(3,))
    leaf = leaf_size or 3 * max(point_spacing(start), point_spacing(goal)) or 1.0
    surface = surface_of(goal, leaf)
    cells = surface_of(start, leaf).centroids
    centre = cells.mean(axis=0)
    motion = np.eye(4)
    for _ in range(int(max_iter)):
        moved = cells @ motion[:3, :3].T + motion[:3, 3]
        distance, number = (part[:, 0] for part in nearest(surface.tree, moved, within=max_distance))
        paired = np.isfinite(distance)
        if not paired.any():
            break
        s, normals = moved[paired], surface.normals[number[paired]]
        gap = ((surface.centroids[number[paired]] - s) * normals).sum(axis=1)
        step = plane_step(s - centre, normals, gap)
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(step[:3]).as_matrix()
        turn[:3, 3] = step[3:] + centre - turn[:3, :3] @ centre
        motion = turn @ motion
        if np.abs(step).max() < 1e-6:
            break
    return motion


def plane_step(s: Floats, normals: Floats, gap: Floats) -> Floats:
    """(6,) rotation vector and shift that bring points s (N, 3) nearest to planes `gap` (N,) away along normals.

    Examples
    --------
    >>> plane_step(np.eye(3), np.eye(3), np.full(3, 0.1)).round(3) + 0.0
    array([0. , 0. , 0. , 0.1, 0.1, 0.1])
    """
    reach = 4.685 * max(1.4826 * float(np.median(np.abs(gap))), 1e-9)  # Tukey's constant; the median as a scale
    weight = np.clip(1 - (gap / reach) ** 2, 0, None) ** 2
    size = np.sqrt((s**2).sum(axis=1).mean()) or 1.0  # turns are measured as the way they move a typical point
    rows = np.concatenate([np.cross(s, normals) / size, normals], axis=1)  # (N, 6)
    values, vectors = np.linalg.eigh((rows * weight[:, None]).T @ rows)
    held = values > WEAKEST * values[-1]
    pull = vectors.T @ (rows.T @ (weight * gap))
    step = vectors[:, held] @ (pull[held] / values[held])
    step[:3] /= size
    return np.asarray(step)
