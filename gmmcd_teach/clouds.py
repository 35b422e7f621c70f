"""Point clouds: arrays of shape (N, D) in metres, read, written and checked (chapter 1)."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.formats import Fields, Malformed, arrays, depth, las, pcd, ply, text
from gmmcd_teach.formats.atomic import write_atomically

Floats = NDArray[np.float64]

Reader = Callable[..., Fields]
Writer = Callable[[BinaryIO, Fields], None]
FORMATS: dict[str, tuple[Reader, Writer]] = {
    ".ply": (ply.read_ply, ply.write_ply),
    ".pcd": (pcd.read_pcd, pcd.write_pcd),
    ".xyz": (text.read_text, text.write_xyz),
    ".csv": (text.read_text, text.write_csv),
    ".npy": (arrays.read_npy, arrays.write_npy),
    ".npz": (arrays.read_npz, arrays.write_npz),
    ".las": (las.read_las, las.write_las),
    ".laz": (las.read_las, las.write_laz),
    ".png": (depth.read_points, depth.refuse_points),
}


class CloudError(ValueError):
    """A cloud that cannot be used: names the file or argument, what is wrong and what would be right."""


def check_points(
    points: ArrayLike,
    name: str = "points",
    *,
    minimum: int = 1,
    dimensions: tuple[int, ...] = (),
) -> Floats:
    """Return `points` as a float64 array of shape (N, D), or say in one line why that cannot be done.

    Parameters
    ----------
    points : array-like (N, D), metres.
    name : what the message calls the array.
    minimum : fewest points allowed.
    dimensions : the D allowed; empty for any D >= 1.

    Raises
    ------
    CloudError
        The array is not numeric, not (N, D), too short, or holds NaN or infinity.

    Examples
    --------
    >>> check_points([[0, 0, 1], [1, 2, 3]]).shape
    (2, 3)
    """
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise CloudError(f"{name}: not an array of numbers; expected shape (N, D) in metres") from None
    wanted = " or ".join(str(d) for d in dimensions) or "1 or more"
    if array.ndim != 2 or array.shape[1] == 0 or (dimensions and array.shape[1] not in dimensions):
        raise CloudError(f"{name}: shape {array.shape}; expected (N, D) with D = {wanted}")
    if len(array) < minimum:
        raise CloudError(f"{name}: {len(array)} points; at least {minimum} needed")
    finite = np.isfinite(array)
    if not finite.all():
        bad = len(array) - np.count_nonzero(finite.all(axis=1))
        raise CloudError(f"{name}: {bad} of {len(array)} points hold NaN or infinity; drop them first")
    return array


def read_cloud(path: str | os.PathLike[str]) -> Floats:
    """Return the points of a cloud file as an array (N, 3), in the file's unit; rows with NaN or infinity are dropped.

    Parameters
    ----------
    path : a file whose suffix is one of .ply .pcd .xyz .csv .npy .npz, .las and .laz (where laspy is installed), or
        .png: a depth image of 16 bits, with the .json beside it that `gmmcd_teach.formats.depth` describes.

    Raises
    ------
    CloudError
        The file is missing, not a cloud of the format that its suffix names, or has no finite point.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_cloud(f"{folder}/two.ply", [[0, 0, 1], [1, 2, 3]])
    ...     read_cloud(f"{folder}/two.ply")
    array([[0., 0., 1.],
           [1., 2., 3.]])
    """
    fields = read_fields(path)
    if missing := [axis for axis in "xyz" if axis not in fields]:
        raise CloudError(f"{path}: no column {missing[0]!r} among {', '.join(fields)[:200]}; expected x, y and z")
    with np.errstate(invalid="ignore"):  # a signalling NaN is a NaN
        points = np.column_stack([fields[axis].ravel().astype(np.float64) for axis in "xyz"])
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        raise CloudError(f"{path}: no point with three finite coordinates; at least 1 needed")
    return points


def read_fields(path: str | os.PathLike[str]) -> Fields:
    """Return every column of the file at `path` by its name, as stored: x, y, z, and labels, colours, normals, ...

    Each is an array (N,), or (N, k) where a point has k numbers under one name. The columns of an organised .pcd
    have the shape of the depth image that they come from, (H, W), NaN where nothing was measured.

    Raises
    ------
    CloudError
        As `read_cloud`. Memory is taken only for what the file can hold: at most 100 times its size.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_cloud(f"{folder}/two.npz", [[0, 0, 1], [1, 2, 3]], label=[0, 7])
    ...     read_fields(f"{folder}/two.npz")["label"]
    array([0, 7])
    """
    path = _checked_path(path)
    if path.exists() and not path.is_file():
        raise CloudError(f"{path}: a directory or device; expected a file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror}); expected a file") from None
    if not data:
        raise CloudError(f"{path}: empty; expected a {path.suffix} file of at least one point")
    try:
        reader = FORMATS[path.suffix.lower()][0]
        return reader(data, depth.sidecar(path)) if reader is depth.read_points else reader(data)
    except Malformed as problem:
        raise CloudError(f"{path}: {problem}") from None


def write_cloud(path: str | os.PathLike[str], points: ArrayLike, **per_point: ArrayLike) -> None:
    """Write points (N, 3) and the columns `per_point` of N numbers, in the format of the suffix.

    The file appears complete or not at all. Numbers come back as they were; coordinates of a .pcd within 10
    micrometres, since it holds float32 wherever that suffices, and those of a .las or .laz, whose steps are of that
    size within 20 km. A .ply, .pcd, .las, .laz, .xyz or .csv takes columns (N,), a .npz also (N, k), a .npy none;
    booleans become 0 and 1 everywhere but in a .npz.

    Raises
    ------
    CloudError
        The points or a column are unfit, the suffix is unknown, or the file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_cloud(f"{folder}/two.csv", [[0, 0, 1], [1, 2, 3]], changed=[False, True])
    ...     print(pathlib.Path(f"{folder}/two.csv").read_text(), end="")
    x,y,z,changed
    0,0,1,0
    1,2,3,1
    """
    path = _checked_path(path)
    points = check_points(points, dimensions=(3,))
    fields: Fields = dict(zip("xyz", points.T, strict=True))
    for name, values in per_point.items():
        fields[name] = _check_column(name, values, len(points), several=path.suffix.lower() == ".npz")
    try:
        write_atomically(path, lambda file: FORMATS[path.suffix.lower()][1](file, fields))
    except Malformed as problem:
        raise CloudError(f"{path}: {problem}") from None
    except OSError as error:
        raise CloudError(f"{path}: cannot be written ({error.strerror}); expected a writable folder") from None


def _check_column(name: str, values: ArrayLike, n_points: int, several: bool) -> NDArray[Any]:
    """Return a per-point column that a file can hold: numbers (N,), or, where it holds `several` to a point, (N, k)."""
    if not (name.isidentifier() and name.isascii()) or name in ("x", "y", "z"):
        raise CloudError(f"column {name!r}: expected a name of letters, digits and _ other than x, y, z")
    try:
        column = np.asarray(values)
    except ValueError:
        raise CloudError(f"column {name!r}: not an array; expected {n_points} numbers") from None
    wanted = (n_points, *column.shape[1:]) if several else (n_points,)
    if column.shape != wanted or column.dtype.kind not in "biuf" or column.dtype.itemsize > 8:
        raise CloudError(f"column {name!r}: {column.dtype} of shape {column.shape}; expected numbers {wanted}")
    if not several and column.dtype.name in ("bool", "float16"):
        return column.astype(np.uint8 if column.dtype == bool else np.float32)
    return column


def _checked_path(path: str | os.PathLike[str]) -> Path:
    if not isinstance(path, (str, os.PathLike)) or "\0" in str(path):
        raise CloudError(f"{path!r}: not a path; expected the name of a file")
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise CloudError(f"{path}: unknown suffix {path.suffix!r}; expected one of {' '.join(FORMATS)}")
    return path
