"""Solids that a ray can meet: boxes and cylinders, placed in the world by a rigid pose (chapter 1)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
TINY = 1e-200  # stands for a direction's component that is exactly zero
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def pose_at(x: float, y: float, z: float, yaw: float = 0.0) -> Floats:
    """Rigid pose (4, 4) at a position in metres, turned by `yaw` radians about the vertical.

    Examples
    --------
    >>> (pose_at(1, 2, 3, np.pi / 2) @ [1, 0, 0, 1]).round(6).tolist()
    [1.0, 3.0, 3.0, 1.0]
    """
    pose = np.eye(4)
    pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    pose[:3, 3] = x, y, z
    return pose


def axis_along(axis: str) -> Floats:
    """Pose (4, 4) at the origin that lays a solid's own z axis along the world's "x", "y" or "z"."""
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), {"x": 2, "y": 1, "z": 0}[axis], axis=1)
    return pose


def transform(pose: Floats, points: ArrayLike) -> Floats:
    """Points (N, 3), or one (3,), moved by a rigid pose (4, 4)."""
    return np.asarray(points, dtype=np.float64) @ pose[:3, :3].T + pose[:3, 3]


def inverse(pose: Floats) -> Floats:
    """Inverse of a rigid pose (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = pose[:3, :3].T
    back[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return back


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid about the origin of its own frame; `pose` (4, 4) takes that frame to the world."""

    pose: Floats = field(default_factory=lambda: np.eye(4), kw_only=True)

    @property
    def half_extent(self) -> Floats:
        """Half the size (3,) in metres of the box, in the solid's own frame, that just holds it."""
        raise NotImplementedError

    @property
    def corners(self) -> Floats:
        """World positions (8, 3) of that box's corners."""
        return transform(self.pose, CORNERS * self.half_extent)

    @property
    def radius(self) -> float:
        """Radius in metres of the sphere about the pose's origin that holds the solid."""
        return float(np.linalg.norm(self.half_extent))

    def placed(self, pose: Floats) -> Solid:
        """The same solid, carried along by a rigid motion (4, 4)."""
        return replace(self, pose=pose @ self.pose)

    def enter(self, origin: Floats, directions: Floats) -> Floats:
        """Where rays from one origin (3,) enter the solid, in units of their length; directions and result are by
        component: (3, N) -> (N,), inf for a miss."""
        rotation = self.pose[:3, :3]
        return self._enter(rotation.T @ (origin - self.pose[:3, 3]), rotation.T @ directions)

    def surface(self, points: Floats) -> tuple[Ints, Floats]:
        """Face (N,) that points (N, 3) on the surface lie on, and the outward normal (N, 3) there."""
        rotation = self.pose[:3, :3]
        face, normal = self._surface((points - self.pose[:3, 3]) @ rotation)
        return face, normal @ rotation.T

    def distance(self, points: Floats) -> Floats:
        """Distance (N,) in metres from points (N, 3) to the surface, never negative."""
        outside, inside = self._excess((points - self.pose[:3, 3]) @ self.pose[:3, :3])
        return np.where(inside < 0, -inside, outside)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Which points (N, 3) lie inside the solid."""
        return self._excess((points - self.pose[:3, 3]) @ self.pose[:3, :3])[1] < 0

    def _enter(self, origin: Floats, directions: Floats) -> Floats:
        raise NotImplementedError

    def _surface(self, points: Floats) -> tuple[Ints, Floats]:
        raise NotImplementedError

    def _excess(self, points: Floats) -> tuple[Floats, Floats]:
        """Distance outside the solid, and the largest excess over its bounds (negative inside)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Box(Solid):
    """A box of `size` (x, y, z) metres.

    Examples
    --------
    >>> Box((2, 2, 2)).enter(np.array([-3.0, 0, 0]), np.array([[1.0], [0.0], [0.0]])).tolist()
    [2.0]
    """

    size: tuple[float, float, float]

    @property
    def half_extent(self) -> Floats:  # noqa: D102
        return np.asarray(self.size) / 2

    def _enter(self, origin: Floats, directions: Floats) -> Floats:
        """The slab test (Kay & Kajiya 1986): inside the box is inside all three pairs of planes at once."""
        per_metre = 1 / np.where(directions == 0, TINY, directions)  # (3, N)
        middle, half = -origin[:, None] * per_metre, self.half_extent[:, None] * np.abs(per_metre)
        enter, leave = (middle - half).max(axis=0), (middle + half).min(axis=0)
        return np.where((enter > 0) & (enter <= leave), enter, np.inf)

    def _surface(self, points: Floats) -> tuple[Ints, Floats]:
        axis = (np.abs(points) - self.half_extent).argmax(axis=1)
        rows = np.arange(len(points))
        normal = np.zeros_like(points)
        normal[rows, axis] = np.sign(points[rows, axis])
        return 2 * axis + (normal[rows, axis] > 0), normal

    def _excess(self, points: Floats) -> tuple[Floats, Floats]:
        excess = np.abs(points) - self.half_extent
        return np.sqrt((np.maximum(excess, 0) ** 2).sum(axis=1)), excess.max(axis=1)


@dataclass(frozen=True, eq=False)
class Cylinder(Solid):
    """A round bar of `diameter` and `length` metres along its own z axis.

    Examples
    --------
    >>> Cylinder(2, 4).enter(np.array([-3.0, 0, 1]), np.array([[1.0], [0.0], [0.0]])).tolist()
    [2.0]
    """

    diameter: float
    length: float

    @property
    def half_extent(self) -> Floats:  # noqa: D102
        return np.array([self.diameter, self.diameter, self.length]) / 2

    def _enter(self, origin: Floats, directions: Floats) -> Floats:
        """Inside the bar is inside the round wall (a quadratic in the distance) and between the two caps."""
        across, per_metre = directions[:2], 1 / np.where(directions[2] == 0, TINY, directions[2])
        a = np.maximum((across**2).sum(axis=0), TINY)
        b = origin[0] * across[0] + origin[1] * across[1]
        square = b * b - a * (origin[:2] @ origin[:2] - self.diameter**2 / 4)  # negative where the ray passes by
        root, half = np.sqrt(np.maximum(square, 0)), self.length / 2 * np.abs(per_metre)
        enter = np.maximum((-b - root) / a, -origin[2] * per_metre - half)
        leave = np.minimum((-b + root) / a, -origin[2] * per_metre + half)
        leave[square < 0] = -np.inf
        return np.where((enter > 0) & (enter <= leave), enter, np.inf)

    def _surface(self, points: Floats) -> tuple[Ints, Floats]:
        from_axis = np.hypot(points[:, 0], points[:, 1])
        on_cap = np.abs(points[:, 2]) - self.length / 2 > from_axis - self.diameter / 2
        normal = np.where(on_cap[:, None], [0, 0, 1], [1, 1, 0]) * points
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return np.where(on_cap, 1 + (points[:, 2] > 0), 0), normal

    def _excess(self, points: Floats) -> tuple[Floats, Floats]:
        excess = np.stack(
            [np.hypot(points[:, 0], points[:, 1]) - self.diameter / 2, np.abs(points[:, 2]) - self.length / 2], axis=1
        )
        return np.sqrt((np.maximum(excess, 0) ** 2).sum(axis=1)), excess.max(axis=1)
