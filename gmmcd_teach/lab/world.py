"""A place made of named things: put things in, take them out, move them, and send rays through it (chapter 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.lab.shapes import Floats, Ints, Solid, inverse, transform

FACES = 6  # at most, of one solid
ALMOST_0 = 1e-9  # metres


class Hits(NamedTuple):
    """What rays meet first: depth in metres (inf: nothing), thing, face, outward normal in the world.

    `thing` (N,) indexes `Scene.things` (-1: nothing); `face` (N,) tells the flat or round faces of the scene apart.
    """

    depth: Floats
    thing: Ints
    face: Ints
    normal: Floats


@dataclass(frozen=True, eq=False)
class Thing:
    """A named thing: solids in its own frame, and the pose (4, 4) that puts that frame into the world."""

    name: str
    parts: tuple[Solid, ...]
    pose: Floats


@dataclass(frozen=True, eq=False)
class Scene:
    """Named things in one world frame (metres, z up). Every change gives a new scene; the old one stays as it was.

    Examples
    --------
    >>> from gmmcd_teach.lab.shapes import Box, pose_at
    >>> scene = Scene().with_object(Thing("crate", (Box((1, 1, 1)),), pose_at(0, 0, 3)))
    >>> scene.moved("crate", pose_at(0, 0, 5)).cast(np.eye(4), np.array([[0.0, 0.0, 1.0]])).depth.tolist()
    [4.5]
    """

    things: tuple[Thing, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all things, in the order they were put in."""
        return tuple(thing.name for thing in self.things)

    def __getitem__(self, name: str) -> Thing:
        if name not in self.names:
            raise ValueError(f"no object named {name!r} in the scene; there are: {', '.join(self.names)}")
        return self.things[self.names.index(name)]

    def with_object(self, thing: Thing) -> Scene:
        """The scene with one more thing; its name must be new (ValueError otherwise)."""
        if thing.name in self.names:
            raise ValueError(f"an object named {thing.name!r} is already in the scene")
        return Scene((*self.things, thing))

    def without(self, name: str) -> Scene:
        """The scene with one thing taken away (ValueError if there is none of that name)."""
        return Scene(tuple(thing for thing in self.things if thing is not self[name]))

    def moved(self, name: str, pose: Floats) -> Scene:
        """The scene with one thing moved to a new pose (4, 4) (ValueError if there is none of that name)."""
        old = self[name]
        return Scene(tuple(replace(thing, pose=pose) if thing is old else thing for thing in self.things))

    @cached_property
    def solids(self) -> tuple[tuple[int, Solid], ...]:
        """Every solid of the scene in world coordinates, with the index of the thing it belongs to."""
        return tuple((i, part.placed(thing.pose)) for i, thing in enumerate(self.things) for part in thing.parts)

    def cast(self, pose: Floats, rays: Floats, tried: NDArray[np.bool_] | None = None) -> Hits:
        """First surface that rays (N, 3) of a camera at `pose` (4, 4) enter; rays in the camera frame, with z = 1.

        A solid is tried only on the rays inside the rectangle that its bounding box covers in the image, or on those
        that `tried` (S, N) names; and not on those that have met something nearer than all of it.
        """
        directions = pose[:3, :3] @ rays.T  # (3, N), in the world
        depth, solid_at = np.full(len(rays), np.inf), np.full(len(rays), -1)
        nearest, rectangles = self._bounds(pose)
        x, y = np.ascontiguousarray(rays[:, :2].T)
        for k, (left, top, right, bottom) in enumerate(rectangles):
            inside = (x >= left) & (x <= right) & (y >= top) & (y <= bottom) if tried is None else tried[k]
            near = np.flatnonzero(inside & (depth > nearest[k]))
            if len(near):
                enter = self.solids[k][1].enter(pose[:3, 3], directions.take(near, axis=1))
                first = enter < depth[near]
                depth[near[first]] = enter[first]
                solid_at[near[first]] = k
        hits = Hits(depth, np.full(len(rays), -1), np.full(len(rays), -1), np.zeros(rays.shape))
        for k in np.unique(solid_at[solid_at >= 0]):
            thing, solid = self.solids[k]
            own = np.flatnonzero(solid_at == k)
            face, hits.normal[own] = solid.surface(pose[:3, 3] + (depth[own] * directions.take(own, axis=1)).T)
            hits.thing[own], hits.face[own] = thing, FACES * k + face
        return hits

    @cached_property
    def _corners(self) -> Floats:
        """World positions (S, 8, 3) of the corners of the solids' bounding boxes."""
        return np.array([solid.corners for _, solid in self.solids]).reshape(-1, 8, 3)

    def _bounds(self, pose: Floats) -> tuple[Floats, Floats]:
        """What solids cover as seen from `pose`: their least z (S,), and a rectangle (S, 4) of x / z and y / z.

        It holds all of a bounding box that lies in front of the camera: corners there, and points on the lines to
        corners behind, where z is almost 0. Left > right where nothing is in front.
        """
        corner = transform(inverse(pose), self._corners)  # (S, 8, 3)
        z = corner[..., 2:]
        step = corner[:, None] - corner[:, :, None]  # (S, 8, 8, 3), from the second axis' corner to the third's
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = (z <= ALMOST_0)[:, :, None] & (z > ALMOST_0)[:, None]
            cut = np.where(crossing, corner[:, :, None] + (ALMOST_0 - z)[:, :, None] / step[..., 2:] * step, np.nan)
            seen = np.where(z > ALMOST_0, corner, np.nan)[..., :2] / z
        seen = np.concatenate([seen, cut[..., :2].reshape(-1, 64, 2) / ALMOST_0], axis=1)
        left_top = np.where(np.isnan(seen), np.inf, seen).min(axis=1) - 1e-9
        right_bottom = np.where(np.isnan(seen), -np.inf, seen).max(axis=1) + 1e-9
        return z.min(axis=(1, 2)), np.concatenate([left_top, right_bottom], axis=1)

    def nearest(self, points: Floats) -> tuple[Floats, Ints]:
        """Distance (N,) in metres from points (N, 3) to the nearest surface, and the index (N,) of its thing."""
        distance, nearest = np.full(len(points), np.inf), np.full(len(points), -1)
        for thing, solid in self.solids:
            to_sphere = np.linalg.norm(points - solid.pose[:3, 3], axis=1) - solid.radius
            close = np.flatnonzero(to_sphere < distance)
            away = solid.distance(points[close])
            closer = away < distance[close]
            distance[close[closer]] = away[closer]
            nearest[close[closer]] = thing
        return distance, nearest
