"""What a 3-D view holds: layers (points, ellipsoids, boxes, cameras) broken into plain meshes, and the camera."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import check_points

from .plots import evenly, fair_shares, split
from .style import CYCLE, color_of

if TYPE_CHECKING:
    from gmmcd_teach.lab.pair import DepthFrame
    from gmmcd_teach.mixture import GaussianMixture

Floats = NDArray[np.float64]
Ints = NDArray[np.intp]
VIEW_ANGLE = 30.0  # degrees from the lower to the upper edge, as VTK's


@dataclass(frozen=True)
class Mesh:
    """One thing of one meaning: vertices (V, 3), and lines (L, 2) or triangles (T, 3) between them, or neither: points.

    `color` is a hex colour, or (V, 3) uint8 for one colour per vertex; `key` is the CSS background of the legend.
    """

    label: str
    color: str | NDArray[np.uint8]
    key: str
    vertices: Floats
    lines: Ints | None = None
    triangles: Ints | None = None
    size: float = 3.0
    opacity: float = 1.0


@dataclass(frozen=True)
class Points:
    """Points (N, 3) in metres, coloured by meaning, or by `groups` (N,) int, or by `values` (N,) float.

    Attributes
    ----------
    meaning : a key of COLORS, or a hex colour, for the points that no mask takes.
    label : legend text in place of the meaning; names the groups or the values too.
    masks : meaning -> (N,) bool or indices.
    size : pixels.

    Examples
    --------
    >>> cloud = Points([[0, 0, 0], [0, 0, 1]], masks={"appeared": [False, True]})
    >>> [mesh.label for mesh in cloud.meshes()]
    ['unchanged', 'appeared']
    """

    points: ArrayLike
    meaning: str = "unchanged"
    label: str | None = None
    masks: Mapping[str, ArrayLike] | None = None
    groups: ArrayLike | None = None
    values: ArrayLike | None = None
    size: float = 2.0
    opacity: float = 1.0

    def meshes(self) -> Iterator[Mesh]:
        """What is drawn."""
        points = check_points(self.points, "points of a view", dimensions=(3,))
        shape: dict[str, Any] = {"size": self.size, "opacity": self.opacity}
        if self.values is not None:
            colors, label, key = _value_colors(self.values, self.label or "value")
            yield Mesh(label, colors, key, points, **shape)
        elif self.groups is not None:
            colors = _rgb(CYCLE)[np.asarray(self.groups) % len(CYCLE)]
            yield Mesh(self.label or "one colour per group", colors, _stripes(), points, **shape)
        else:
            for name, chosen in split(len(points), self.meaning, self.masks).items():
                if len(chosen):
                    label = self.label if self.label and name == self.meaning else name
                    yield Mesh(label, color_of(name), color_of(name), points[chosen], **shape)


@dataclass(frozen=True)
class Ellipsoids:
    """The components of a mixture as ellipsoids at `n_std` standard deviations, truly oriented.

    Attributes
    ----------
    mixture : weights (K,), means (K, 3), covariances (K, 3, 3), metres.
    meaning, label, masks : as for Points, for components: {"appeared": detection.appeared_components}.
    groups : one colour per component, the colours of Points(groups=mixture.assign(points)).
    """

    mixture: GaussianMixture
    meaning: str = "after"
    label: str | None = None
    masks: Mapping[str, ArrayLike] | None = None
    groups: bool = False
    n_std: float = 2.0
    opacity: float = 0.25

    def meshes(self) -> Iterator[Mesh]:
        """What is drawn."""
        vertices, triangles = ellipsoids(self.mixture.means, self.mixture.covariances, self.n_std)
        n_components, n_vertices, _ = vertices.shape
        parts = {"": np.arange(n_components)} if self.groups else split(n_components, self.meaning, self.masks)
        for name, ks in parts.items():
            if not len(ks):
                continue
            color: str | NDArray[np.uint8]
            if self.groups:
                label, key = self.label or "one colour per component", _stripes()
                color = _rgb(CYCLE)[ks % len(CYCLE)].repeat(n_vertices, axis=0)
            else:
                label = self.label if self.label and name == self.meaning else name
                color = key = color_of(name)
            label += f" (ellipsoid at {self.n_std:g} standard deviations)"
            faces = (triangles + n_vertices * np.arange(len(ks))[:, None, None]).reshape(-1, 3)
            yield Mesh(label, color, key, vertices[ks].reshape(-1, 3), triangles=faces, opacity=self.opacity)


@dataclass(frozen=True)
class Boxes:
    """Outlines of boxes: `bounds` (B, 2, 3), the lower and the upper corner of each, metres."""

    bounds: ArrayLike
    meaning: str = "truth"
    label: str | None = None

    def meshes(self) -> Iterator[Mesh]:
        """What is drawn."""
        bounds = np.atleast_3d(np.asarray(self.bounds, dtype=np.float64).reshape(-1, 2, 3))
        bits = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)  # (8, 3)
        corners = bounds[:, bits, np.arange(3)]  # (B, 8, 3)
        pairs = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])  # (12, 2)
        yield _wires(corners, pairs, self.label or self.meaning, color_of(self.meaning))


@dataclass(frozen=True)
class Lines:
    """Straight lines from `starts` (L, 3) to `ends` (L, 3), metres; `width` in pixels."""

    starts: ArrayLike
    ends: ArrayLike
    meaning: str = "truth"
    label: str | None = None
    width: float = 2.0

    def meshes(self) -> Iterator[Mesh]:
        """What is drawn."""
        ends = np.stack([np.asarray(self.starts, dtype=np.float64), np.asarray(self.ends, dtype=np.float64)], axis=1)
        wires = _wires(ends, np.array([[0, 1]]), self.label or self.meaning, color_of(self.meaning))
        yield replace(wires, size=self.width)


@dataclass(frozen=True)
class Frusta:
    """What each depth camera sees: a pyramid from its pose, `reach` metres long."""

    frames: Sequence[DepthFrame]
    meaning: str = "camera"
    label: str | None = None
    reach: float = 0.3

    def meshes(self) -> Iterator[Mesh]:
        """What is drawn."""
        corners = np.stack([frustum(frame, self.reach) for frame in self.frames])  # (F, 5, 3)
        pairs = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
        yield _wires(corners, pairs, self.label or self.meaning, color_of(self.meaning))


Layer = Points | Ellipsoids | Boxes | Lines | Frusta


def frustum(frame: DepthFrame, reach: float) -> Floats:
    """Return (5, 3): the camera's centre and the corners of its image at depth `reach` metres, in world coordinates."""
    rows, columns = frame.depth.shape
    fx, fy, cx, cy = frame.intrinsics
    u, v = np.array([0, columns, columns, 0]), np.array([0, 0, rows, rows])
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(4)], axis=1)
    local = np.vstack([np.zeros(3), reach * rays])
    return local @ frame.pose[:3, :3].T + frame.pose[:3, 3]


def ellipsoids(
    means: ArrayLike, covariances: ArrayLike, n_std: float = 2.0, *, n_around: int = 24, n_along: int = 13
) -> tuple[Floats, Ints]:
    """Return vertices (K, V, 3) at exactly `n_std` standard deviations from each mean, and triangles (T, 3) for one.

    Each vertex is m + n_std V diag(sqrt(variances)) u: a unit vector u, stretched along the principal axes V.

    Examples
    --------
    >>> vertices, triangles = ellipsoids([[0, 0, 0]], [np.eye(3)])
    >>> bool(np.allclose(np.linalg.norm(vertices, axis=-1), 2))
    True
    """
    means = np.asarray(means, dtype=np.float64)
    variances, axes = np.linalg.eigh(np.asarray(covariances, dtype=np.float64))  # (K, 3), (K, 3, 3)
    longitude = 2 * np.pi * np.arange(n_around) / n_around
    latitude = np.pi * np.arange(1, n_along - 1)[:, None] / (n_along - 1)
    ring = [
        np.sin(latitude) * np.cos(longitude),
        np.sin(latitude) * np.sin(longitude),
        np.cos(latitude) + 0 * longitude,
    ]
    sphere = np.vstack([[0, 0, 1], np.stack(ring, axis=-1).reshape(-1, 3), [0, 0, -1]])  # (V, 3)
    stretch = n_std * axes * np.sqrt(np.maximum(variances, 0))[:, None, :]  # (K, 3, 3)
    vertices = means[:, None] + sphere @ stretch.swapaxes(1, 2)

    i = np.arange(n_around)
    j = (i + 1) % n_around
    starts = 1 + n_around * np.arange(n_along - 3)[:, None]  # first vertex of each ring but the last
    bands = [
        (starts + a, starts + b, starts + c) for a, b, c in [(i, n_around + i, j), (j, n_around + i, n_around + j)]
    ]
    last = len(sphere) - 1
    caps = [(0 * i, 1 + i, 1 + j), (last + 0 * i, last - n_around + j, last - n_around + i)]
    triangles = np.concatenate([np.stack(part, axis=-1).reshape(-1, 3) for part in [*bands, *caps]])
    return vertices, triangles


@dataclass(frozen=True)
class Camera:
    """Where a view is seen from: position, focal point and the direction that points up, (3,) each, metres."""

    position: tuple[float, float, float]
    focal_point: tuple[float, float, float]
    up: tuple[float, float, float]

    def project(self, points: ArrayLike) -> Floats:
        """Return (N, 2) coordinates in the picture, to the right and up, 1 at its upper edge."""
        right, up, forward = _camera_axes(np.subtract(self.focal_point, self.position), self.up)
        seen = (np.asarray(points, dtype=np.float64) - self.position) @ np.stack([right, up, forward], axis=1)
        depth = np.maximum(seen[:, 2:], 1e-9)
        return seen[:, :2] / (depth * np.tan(np.radians(VIEW_ANGLE / 2)))


CAMERAS: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "oblique": ((0.6, 0.8, -0.75), (0, 0, 1)),
    "top": ((0, 0, -1), (0, 1, 0)),
    "front": ((0, 1, 0), (0, 0, 1)),
    "back": ((0, -1, 0), (0, 0, 1)),
    "side": ((-1, 0, 0), (0, 0, 1)),
    "sensor": ((0.25, 0.4, 1), (0, -1, 0)),
}
"""Name -> direction of sight and up. "sensor": for points in a camera's frame, from behind it and a little above."""


def fitted_camera(meshes: Sequence[Mesh], name: str = "oblique", *, aspect: float = 1.0) -> Camera:
    """Return the named camera, as close as it can be with all lines and all but the outermost points in its picture.

    `aspect` is the picture's width / height.

    Raises
    ------
    ValueError
        No camera of that name.
    """
    if name not in CAMERAS:
        raise ValueError(f"camera {name!r}: not one of {', '.join(CAMERAS)}, nor a Camera")
    points = np.concatenate([mesh.vertices if mesh.lines is not None else _inner(mesh.vertices) for mesh in meshes])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    forward, up = (np.array(vector, dtype=np.float64) for vector in CAMERAS[name])
    axes = np.stack(_camera_axes(forward, up), axis=1)
    seen = (points - middle) @ axes
    needed = np.abs(seen[:, :2] / [aspect, 1]).max(axis=1) / np.tan(np.radians(VIEW_ANGLE / 2)) - seen[:, 2]
    position = middle - 1.05 * max(float(needed.max()), 1e-3) * axes[:, 2]
    return Camera(_triple(position), _triple(middle), _triple(up))


def thinned(meshes: Sequence[Mesh], max_points: int) -> list[Mesh]:
    """Return the meshes with at most `max_points` points in all; small groups stay whole, large ones share the rest.

    Which points stay depends on their number alone, so that the same view is the same page.
    """
    clouds = [i for i, mesh in enumerate(meshes) if is_cloud(mesh)]
    shares = fair_shares([len(meshes[i].vertices) for i in clouds], max_points)
    result = list(meshes)
    for i, share in zip(clouds, shares, strict=True):
        vertices, color = meshes[i].vertices, meshes[i].color
        kept = evenly(len(vertices), share)
        result[i] = replace(meshes[i], vertices=vertices[kept], color=color if isinstance(color, str) else color[kept])
    return result


def _inner(points: Floats) -> Floats:
    """Pull the outermost half per cent of the points in along each axis."""
    return np.clip(points, *np.quantile(points, [0.005, 0.995], axis=0))


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def is_cloud(mesh: Mesh) -> bool:
    """Whether a mesh is loose points."""
    return mesh.lines is None and mesh.triangles is None


def _camera_axes(forward: ArrayLike, up: ArrayLike) -> tuple[Floats, Floats, Floats]:
    forward = np.asarray(forward, dtype=np.float64) / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, dtype=np.float64))
    right /= np.linalg.norm(right)
    return right, np.cross(right, forward), forward


def _wires(corners: Floats, pairs: Ints, label: str, color: str) -> Mesh:
    """Join the corners (B, C, 3) of each of B things by the same pairs (P, 2)."""
    lines = (pairs + corners.shape[1] * np.arange(len(corners))[:, None, None]).reshape(-1, 2)
    return Mesh(label, color, color, corners.reshape(-1, 3), lines=lines, size=2.0)


def _rgb(colors: Sequence[str]) -> NDArray[np.uint8]:
    return np.array([[int(color[i : i + 2], 16) for i in (1, 3, 5)] for color in colors], dtype=np.uint8)


def _stripes() -> str:
    width = 100 / len(CYCLE)
    stops = ", ".join(f"{color} {i * width:g}% {(i + 1) * width:g}%" for i, color in enumerate(CYCLE))
    return f"linear-gradient(90deg, {stops})"


def _value_colors(values: ArrayLike, label: str) -> tuple[NDArray[np.uint8], str, str]:
    """Return viridis colours (N, 3) for the values, the legend's text with the range, and its CSS gradient."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    numbers = np.asarray(values, dtype=np.float64)
    low, high = float(np.nanmin(numbers)), float(np.nanmax(numbers))
    scaled = (numbers - low) / (high - low or 1.0)
    colormap = colormaps["viridis"]
    stops = ", ".join(to_hex(colormap(x)) for x in np.linspace(0, 1, 5))
    colors = np.round(255 * colormap(scaled)[:, :3]).astype(np.uint8)
    digits = max(0, 2 - math.floor(math.log10(high - low or 1.0)))  # of both ends, to a hundredth of what is between
    return colors, f"{label}: {low:.{digits}f} to {high:.{digits}f}", f"linear-gradient(90deg, {stops})"
