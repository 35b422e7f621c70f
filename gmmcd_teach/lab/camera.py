"""The depth camera: from a scene to an image of depths, and from pixels to points (chapter 1).

Numbers of the real sensor, the HazCam of the Astrobee robot (a PMD pico flexx):

- image 224 x 172 pixels, 5 images a second: the paper (nasa/astrobee `config/cameras.config` says 224 x 171)
- pinhole intrinsics: nasa/astrobee `config/robots/bsharp.config`; its lens distortion is left out here
- range used, 0.2 to 4 m: nasa/astrobee `config/mobility/mapper.config`

Stand-ins, since nobody has published these for the real sensor:

- axial and lateral noise: the laws that Nguyen, Izadi & Lovell (2012) fitted to another camera, the Kinect v1
- flying pixels: plain average of the depths seen within one pixel, after Keller & Kolb (2009); a real time-of-flight
  camera averages waves, not depths
- missing returns: the probability falls linearly from 1 at 70 degrees of incidence to 0 at 85 degrees; chosen here
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.lab.shapes import Floats, Ints, inverse, transform
from gmmcd_teach.lab.world import FACES, Scene

WIDTH, HEIGHT = 224, 172
INTRINSICS = (188.27394, 186.18359, 117.94881, 87.740547)  # fx, fy, cx, cy in pixels
NEAREST, FARTHEST = 0.2, 4.0  # metres along the optical axis
ALL_RETURN, NONE_RETURN = np.radians(70), np.radians(85)  # incidence: stand-in
SUB_RAYS = 3  # a pixel's footprint is sampled 3 x 3: stand-in
EDGE_REACH = 3  # pixels from an edge within which lateral noise can matter


def axial_sigma(depth: Floats, incidence: Floats) -> Floats:
    """Standard deviation of depth in metres (Nguyen et al. 2012); `incidence` in radians from the surface normal.

    Examples
    --------
    >>> float(axial_sigma(np.array(0.4), np.array(0.0)))
    0.0012
    """
    slant = incidence**2 / (np.pi / 2 - incidence) ** 2
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2 + 0.0001 / np.sqrt(depth) * slant


def lateral_sigma(incidence: Floats) -> Floats:
    """Standard deviation, in pixels, of where a pixel looks (Nguyen et al. 2012)."""
    return 0.8 + 0.035 * incidence / (np.pi / 2 - incidence)


def return_probability(incidence: Floats) -> Floats:
    """Probability that light comes back at all: 1 up to 70 degrees of incidence, 0 from 85 (stand-in)."""
    return np.clip((NONE_RETURN - incidence) / (NONE_RETURN - ALL_RETURN), 0, 1)


class View(NamedTuple):
    """A noise-free image, all (H, W): depth (NaN: no return), thing and face as in `Hits`, incidence in radians."""

    depth: Floats
    thing: Ints
    face: Ints
    incidence: Floats


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole depth camera; the camera looks along +z, x to the right, y down.

    Each imperfection has its own switch: `axial` noise along the optical axis, `lateral` noise of where a pixel looks,
    `flying` pixels at edges, `grazing` surfaces that send nothing back. `DepthCamera.perfect()` has none.
    """

    intrinsics: tuple[float, float, float, float] = INTRINSICS
    shape: tuple[int, int] = (HEIGHT, WIDTH)
    axial: bool = True
    lateral: bool = True
    flying: bool = True
    grazing: bool = True

    @classmethod
    def perfect(cls) -> DepthCamera:
        """The camera with every imperfection switched off."""
        return cls(axial=False, lateral=False, flying=False, grazing=False)

    def rays(self) -> Floats:
        """Direction (H, W, 3) of each pixel's centre in the camera frame, scaled so that z = 1."""
        rows, columns = np.indices(self.shape, dtype=np.float64)
        return pixel_rays(columns, rows, self.intrinsics)

    def view(self, scene: Scene, pose: Floats) -> View:
        """What every pixel's centre sees from a pose (4, 4), without noise."""
        rays = self.rays().reshape(-1, 3)
        hits = scene.cast(pose, rays)
        in_range = (hits.depth >= NEAREST) & (hits.depth <= FARTHEST)
        cosine = -(hits.normal @ pose[:3, :3] * rays).sum(axis=1) / np.linalg.norm(rays, axis=1)
        incidence = np.where(hits.thing >= 0, np.arccos(np.clip(cosine, 0, 1)), np.nan)
        depth = np.where(in_range, hits.depth, np.nan)
        return View(
            depth.reshape(self.shape),
            hits.thing.reshape(self.shape),
            hits.face.reshape(self.shape),
            incidence.reshape(self.shape),
        )

    def capture(self, scene: Scene, pose: Floats, rng: np.random.Generator | int) -> Floats:
        """Depth image (H, W) in metres, NaN where nothing came back, taken from `pose` (4, 4)."""
        rng = np.random.default_rng(rng)
        view = self.view(scene, pose)
        depth, incidence = view.depth.copy(), view.incidence
        if self.lateral or self.flying:
            edge = near_edges(view.face, EDGE_REACH if self.lateral else 1)
            depth[edge] = self._at_edges(scene, pose, view, edge, rng)
        slanted = np.where(np.isfinite(incidence), incidence, 0)
        if self.grazing:
            depth[rng.random(self.shape) >= return_probability(slanted)] = np.nan
        if self.axial:
            depth += axial_sigma(np.where(np.isfinite(depth), depth, 1), slanted) * rng.standard_normal(self.shape)
        return np.where((depth >= NEAREST) & (depth <= FARTHEST), depth, np.nan)

    def _at_edges(
        self, scene: Scene, pose: Floats, view: View, edge: NDArray[np.bool_], rng: np.random.Generator
    ) -> Floats:
        """Depth (n,) of the pixels near edges, where a pixel may look beside its centre or see two surfaces at once.

        Displaced rays are tried on what the pixels around see. The surface that such a ray meets answers along the
        pixel's own ray, as its tangent plane would: so a wall stays flat, and only the outline moves.
        """
        rows, columns = np.nonzero(edge)  # (n,)
        jitter = np.zeros((2, len(rows)))
        if self.lateral:
            incidence = view.incidence[edge]
            jitter = lateral_sigma(np.where(np.isfinite(incidence), incidence, 0)) * rng.standard_normal(jitter.shape)
        steps = (np.arange(SUB_RAYS) - (SUB_RAYS - 1) / 2) / SUB_RAYS if self.flying else np.zeros(1)
        down, right = (step.reshape(-1, 1) for step in np.meshgrid(steps, steps, indexing="ij"))  # (s, 1)
        own = pixel_rays(columns.astype(float), rows.astype(float), self.intrinsics)  # (n, 3)
        looked = pixel_rays(columns + jitter[0] + right, rows + jitter[1] + down, self.intrinsics)  # (s, n, 3)
        size = 2 * EDGE_REACH + 3
        around = np.zeros((len(scene.solids), len(rows)), dtype=bool)
        for k in np.unique(view.face[view.face >= 0] // FACES):
            around[k] = maximum_filter(view.face // FACES == k, size)[edge]
        hits = scene.cast(pose, looked.reshape(-1, 3), np.tile(around, len(down)))
        met = np.isfinite(hits.depth)
        normal = (hits.normal @ pose[:3, :3]).reshape(looked.shape)
        plane = np.where(met, hits.depth, 0) * (normal * looked).sum(axis=2).ravel()
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = plane / (normal * own).sum(axis=2).ravel()
        returned = met & (depth >= NEAREST) & (depth <= FARTHEST)
        count = returned.reshape(len(down), -1).sum(axis=0)
        total = np.where(returned, depth, 0).reshape(len(down), -1).sum(axis=0)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def pixel_rays(columns: Floats, rows: Floats, intrinsics: tuple[float, float, float, float]) -> Floats:
    """Directions (..., 3) in the camera frame through image positions in pixels, scaled so that z = 1."""
    fx, fy, cx, cy = intrinsics
    x, y = np.broadcast_arrays((columns - cx) / fx, (rows - cy) / fy)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def near_edges(face: Ints, reach: int) -> NDArray[np.bool_]:
    """Pixels (H, W) with more than one face among their neighbours up to `reach` pixels away."""
    size = 2 * reach + 1
    return maximum_filter(face, size) != minimum_filter(face, size)


def back_project(depth: Floats, intrinsics: tuple[float, float, float, float]) -> Floats:
    """Points (N, 3) in the camera frame of all pixels of a depth image (H, W) that have a return, row by row.

    Examples
    --------
    >>> back_project(np.array([[np.nan, 2.0]]), (1.0, 1.0, 0.0, 0.0)).tolist()
    [[2.0, 0.0, 2.0]]
    """
    rows, columns = np.nonzero(np.isfinite(depth))
    return depth[rows, columns, None] * pixel_rays(columns.astype(float), rows.astype(float), intrinsics)


def project(points: Floats, intrinsics: tuple[float, float, float, float]) -> tuple[Floats, Floats]:
    """Image positions (2, N), columns and rows in pixels, and depths (N,) of points (N, 3) in the camera frame."""
    fx, fy, cx, cy = intrinsics
    x, y, depth = np.ascontiguousarray(points.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([fx * x / depth + cx, fy * y / depth + cy]), depth


def frame_points(frame: DepthFrame) -> Floats:
    """World points (N, 3) of a frame, by its estimated pose."""
    return transform(frame.pose, back_project(frame.depth, frame.intrinsics))


def frame_pixels(frame: DepthFrame, points: Floats) -> tuple[Floats, Floats]:
    """Image positions (2, N) and depths (N,) of world points (N, 3) in a frame, by its estimated pose."""
    return project(transform(inverse(frame.pose), points), frame.intrinsics)
