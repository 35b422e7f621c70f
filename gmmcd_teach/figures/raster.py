"""Pictures of dense clouds: every point drawn, near ones before far ones, edges shaded so that shapes can be told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .cards import png
from .scenes import Camera, Floats, Mesh, Points, fitted_camera
from .style import INK, PAPER

Image = NDArray[np.uint8]
RING = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
FAR = 1e9  # metres, the distance of an empty pixel
REACHES = (2, 5, 12)  # pixels: edges, dents, larger shapes


def raster(meshes: Sequence[Mesh], camera: Camera, width: int = 480, height: int = 400) -> Image:
    """Return the points of `meshes` as the camera sees them, (height, width, 3) uint8.

    A pixel shows the nearest point; it is the darker, the more its neighbours stand out before it: eye-dome lighting
    (Boucheny 2009), which needs no normals.

    Examples
    --------
    >>> dot = Mesh("dot", "#D55E00", "", np.zeros((1, 3)))
    >>> image = raster([dot], Camera((0, 0, -1), (0, 0, 0), (0, 1, 0)), 9, 9)
    >>> image[4, 4].tolist(), image[0, 0].tolist() == rgb(PAPER).tolist()
    ([213, 94, 0], True)
    """
    points = np.concatenate([mesh.vertices for mesh in meshes])
    colors = np.concatenate([np.broadcast_to(_colors(mesh), (len(mesh.vertices), 3)) for mesh in meshes])
    wide, high = 2 * width, 2 * height  # drawn twice as large, then averaged
    forward = np.subtract(camera.focal_point, camera.position)
    depth = (points - camera.position) @ (forward / np.linalg.norm(forward))
    flat = camera.project(points) * [high / 2, -high / 2] + [wide / 2, high / 2]  # column, row
    ahead = (depth > 0) & (flat > -9).all(axis=1) & (flat < [wide + 9, high + 9]).all(axis=1)
    order = np.flatnonzero(ahead)[np.argsort(-depth[ahead], kind="stable")]  # far ones first: near ones overwrite them
    column, row = np.floor(flat[order]).astype(np.intp).T
    distance = np.full(high * wide, np.inf)
    owner = np.full(high * wide, len(points))
    reach = int(np.clip(np.ceil(np.sqrt(wide * high / max(len(order), 1)) / 2), 1, 6))
    steps = range(-reach, reach + 1)
    for i, j in [(i, j) for i in steps for j in steps if i * i + j * j <= reach**2]:
        r, c = row + i, column + j
        shown = np.flatnonzero((r >= 0) & (r < high) & (c >= 0) & (c < wide))
        pixel = (r * wide + c)[shown]
        nearer = depth[order[shown]] < distance[pixel]
        distance[pixel[nearer]] = depth[order[shown[nearer]]]  # of several points in one pixel, the last is the nearest
        owner[pixel[nearer]] = order[shown[nearer]]
    image = np.concatenate([colors, rgb(PAPER)[None]])[owner].reshape(high, wide, 3)
    image = image * _eye_dome(distance.reshape(high, wide))[..., None]
    return np.rint(image.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))).astype(np.uint8)


def _eye_dome(distance: Floats, strength: float = 25.0) -> NDArray[np.float32]:
    """Brightness (H, W) of each pixel, 0 to 1: less where neighbours are nearer; empty pixels stay bright."""
    empty = ~np.isfinite(distance)
    depth = np.log(np.where(empty, FAR, distance)).astype(np.float32)
    high, wide = depth.shape
    padded = np.pad(depth, max(REACHES), constant_values=np.log(FAR))
    hidden = np.zeros_like(depth)
    for reach in REACHES:
        for i, j in RING:
            down, right = max(REACHES) + reach * i, max(REACHES) + reach * j
            hidden += np.clip(depth - padded[down : down + high, right : right + wide], 0, 0.02 * reach) / reach
    hidden[empty] = 0.0
    return np.maximum(np.exp(-strength * hidden / len(REACHES)), 0.3)


def rgb(color: str) -> Image:
    """(3,) uint8 of a hex colour.

    Examples
    --------
    >>> rgb("#D55E00")
    array([213,  94,   0], dtype=uint8)
    """
    return np.frombuffer(bytes.fromhex(color[1:]), np.uint8)


def _colors(mesh: Mesh) -> Image:
    return rgb(mesh.color) if isinstance(mesh.color, str) else mesh.color


def panels_png(panels: Mapping[str, Points], camera: str | Camera = "oblique") -> bytes:
    """Return a PNG of clouds side by side, seen from one place, with their titles and what the colours mean.

    Examples
    --------
    >>> panels_png({"before": Points(np.random.default_rng(0).uniform(size=(500, 3)))})[:4]
    b'\\x89PNG'
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    meshes = {title: list(cloud.meshes()) for title, cloud in panels.items()}
    if isinstance(camera, str):
        camera = fitted_camera([mesh for panel in meshes.values() for mesh in panel], camera, aspect=1.2)
    images = [raster(panel, camera, 720, 600) for panel in meshes.values()]
    drawn = np.any([(image != rgb(PAPER)).any(axis=2) for image in images], axis=0)
    rows, columns = (np.flatnonzero(drawn.any(axis=axis)) for axis in (1, 0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if drawn.any() else np.s_[:, :]
    high, wide, _ = images[0][part].shape
    figure = Figure(figsize=(4.8 * len(panels), 4.6 * high / wide + 0.9), facecolor=PAPER, layout="constrained")
    for ax, title, image in zip(np.atleast_1d(figure.subplots(1, len(panels))), meshes, images, strict=True):
        ax.imshow(image[part])
        ax.set_title(title, color=INK, weight="bold", size=13, loc="center")
        ax.set_axis_off()
    keys = {mesh.label: mesh.key for panel in meshes.values() for mesh in panel}
    patches = [Patch(color=color, label=label) for label, color in keys.items()]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), frameon=False, fontsize=11)
    return png(figure, dpi=110)
