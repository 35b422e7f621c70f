"""Depth images: a 16-bit grey .png, and beside it a .json of the same name that says what a pixel means.

::

    {"intrinsics": [fx, fy, cx, cy], "scale": 0.001, "pose": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}

intrinsics: pixels. scale: metres for each step of grey, 0.001 where it is not given. pose: camera to world, 4 by 4,
metres, the identity where it is not given; the camera looks along +z, x to the right, y down. A grey of 0 is a pixel
without a return.
"""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.formats import Fields, Malformed
from gmmcd_teach.formats.arrays import FLOOR, RATIO
from gmmcd_teach.formats.atomic import write_atomically, write_text_atomically

Floats = NDArray[np.float64]
KEYS = ("intrinsics", "scale", "pose")


class DepthImage(NamedTuple):
    """Depth (H, W) in metres, NaN without a return; pose (4, 4) camera to world; intrinsics (fx, fy, cx, cy) pixels.

    The fields are those of `DepthFrame`, in its order: `DepthFrame(*image)`.
    """

    depth: Floats
    pose: Floats
    intrinsics: tuple[float, float, float, float]


def read_depth(path: str | os.PathLike[str]) -> DepthImage:
    """Read a depth image and the .json beside it.

    Raises
    ------
    CloudError
        Either file is missing or is not what the top of this module says.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_depth(f"{folder}/a.png", [[1.0, 2.0], [np.nan, 3.0]], intrinsics=(2, 2, 0.5, 0.5))
    ...     read_depth(f"{folder}/a.png").depth
    array([[ 1.,  2.],
           [nan,  3.]])
    """
    from gmmcd_teach.clouds import CloudError

    path = Path(path)
    try:
        return parse_depth(path.read_bytes(), sidecar(path))
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror}); expected a depth image") from None
    except Malformed as problem:
        raise CloudError(f"{path}: {problem}") from None


def write_depth(
    path: str | os.PathLike[str],
    depth: ArrayLike,
    *,
    intrinsics: ArrayLike,
    pose: ArrayLike | None = None,
    scale: float = 0.001,
) -> None:
    """Write a depth image (H, W) in metres, rounded to `scale`, and the .json beside it; NaN becomes 0.

    Raises
    ------
    CloudError
        The path does not end in .png, the depth is no image or is too far for 16 bits, the rest is not what the top of
        this module says, or a file cannot be written.

    Examples
    --------
    >>> write_depth("a.png", [[99.0]], intrinsics=(1, 1, 0, 0))
    Traceback (most recent call last):
    gmmcd_teach.clouds.CloudError: a.png: depth up to 99 m; expected 0.001 to 65.535 m at a scale of 0.001
    """
    from PIL import Image

    from gmmcd_teach.clouds import CloudError

    path = Path(path)
    given = {"intrinsics": intrinsics, "scale": scale} | ({} if pose is None else {"pose": pose})
    try:
        if path.suffix.lower() != ".png":
            raise Malformed(f"suffix {path.suffix!r}; expected .png")
        scale, turn, pinhole = _checked(given)
        meaning = {"intrinsics": pinhole, "scale": scale} | ({} if pose is None else {"pose": turn.tolist()})
        try:
            image = np.asarray(depth, dtype=np.float64)
        except (TypeError, ValueError):
            raise Malformed("depth is not an array of numbers; expected (H, W) in metres") from None
        if image.ndim != 2 or image.size == 0:
            raise Malformed(f"depth of shape {image.shape}; expected (H, W) in metres")
        grey = np.rint(np.nan_to_num(image, nan=0.0, posinf=np.inf) / scale)
        if grey.min() < 0 or grey.max() > 65535:
            far = image[np.argmax(np.abs(np.nan_to_num(image))) // image.shape[1]]
            raise Malformed(
                f"depth up to {np.nanmax(far):g} m; expected {scale:g} to {65535 * scale:g} m at a scale of {scale:g}"
            )

        def write(file: BinaryIO) -> None:
            Image.fromarray(grey.astype(np.uint16)).save(file, "PNG")

        write_text_atomically(path.with_suffix(".json"), json.dumps(meaning))
        write_atomically(path, write)
    except Malformed as problem:
        raise CloudError(f"{path}: {problem}") from None
    except OSError as error:
        raise CloudError(f"{path}: cannot be written ({error.strerror}); expected a writable folder") from None


def sidecar(path: Path) -> bytes:
    """The bytes of the .json beside a depth image."""
    try:
        return path.with_suffix(".json").read_bytes()
    except OSError:
        name = path.with_suffix(".json").name
        raise Malformed(f'no {name} beside it; expected one with "intrinsics": [fx, fy, cx, cy]') from None


def parse_depth(data: bytes, meaning: bytes) -> DepthImage:
    """A depth image from the bytes of its two files."""
    try:
        scale, pose, intrinsics = _checked(json.loads(meaning))
    except (ValueError, RecursionError) as error:
        raise error if isinstance(error, Malformed) else Malformed("the .json beside it is not JSON") from None
    grey = _grey(data)
    depth = np.where(grey > 0, grey * scale, np.nan)
    return DepthImage(depth, pose, intrinsics)


def read_points(data: bytes, meaning: bytes) -> Fields:
    """The pixels as points in the world: x, y, z of shape (H, W), NaN without a return."""
    depth, pose, (fx, fy, cx, cy) = parse_depth(data, meaning)
    row, column = np.indices(depth.shape)
    rays = np.stack([(column - cx) / fx, (row - cy) / fy, np.ones(depth.shape)], axis=-1)  # (H, W, 3)
    points = (depth[..., None] * rays) @ pose[:3, :3].T + pose[:3, 3]
    return dict(zip("xyz", np.moveaxis(points, -1, 0), strict=True))


def refuse_points(file: BinaryIO, fields: Fields) -> None:
    """Points cannot become a depth image again."""
    raise Malformed("a depth image is not written from points; expected another suffix, or write_depth")


def _grey(data: bytes) -> NDArray[np.uint16]:
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            if image.mode not in ("I;16", "I;16B", "I"):
                raise Malformed(f"an image of mode {image.mode}; expected grey of 16 bits")
            if 2 * image.width * image.height > max(RATIO * len(data), FLOOR):
                raise Malformed(f"unpacks to {image.width} x {image.height} pixels; expected a depth image")
            return np.asarray(image).astype(np.uint16)
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, SyntaxError, ValueError) as error:
        if isinstance(error, Malformed):
            raise
        raise Malformed("not a whole .png file; expected grey of 16 bits") from None


def _checked(meaning: Any) -> tuple[float, Floats, tuple[float, float, float, float]]:
    """Scale, pose and intrinsics of a sidecar, or what is wrong with it."""
    if not isinstance(meaning, dict) or "intrinsics" not in meaning or (unknown := sorted(set(meaning) - set(KEYS))):
        wrong = (
            f"has a key {unknown[0]!r}" if isinstance(meaning, dict) and "intrinsics" in meaning else "lacks intrinsics"
        )
        raise Malformed(f"the .json beside it {wrong}; expected {', '.join(KEYS)}")
    arrays = {}
    for name, default, shape in (
        ("intrinsics", None, (4,)),
        ("scale", 0.001, ()),
        ("pose", np.eye(4).tolist(), (4, 4)),
    ):
        try:
            arrays[name] = np.asarray(meaning.get(name, default), dtype=np.float64)
        except (TypeError, ValueError):
            raise Malformed(f"{name} in the .json is not made of numbers; expected shape {shape}") from None
        if arrays[name].shape != shape or not np.isfinite(arrays[name]).all():
            raise Malformed(f"{name} in the .json has shape {arrays[name].shape}; expected {shape} finite numbers")
    turn, scale, (fx, fy, cx, cy) = arrays["pose"][:3, :3], float(arrays["scale"]), arrays["intrinsics"].tolist()
    if not (fx > 0 and fy > 0 and scale > 0):
        raise Malformed("fx, fy or scale in the .json is not above 0; expected pixels, pixels and metres")
    straight = np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) and np.linalg.det(turn) > 0
    if not straight or not np.allclose(arrays["pose"][3], [0, 0, 0, 1]):
        raise Malformed("pose in the .json is no rotation and shift; expected camera to world, last row 0 0 0 1")
    return scale, arrays["pose"], (fx, fy, cx, cy)
