"""The format of surveyors: .las and, packed, .laz (ASPRS), read and written by laspy where it is installed."""

from __future__ import annotations

import io
import struct
from typing import Any, BinaryIO

import numpy as np

from gmmcd_teach.formats import Fields, Malformed, check_room
from gmmcd_teach.formats.arrays import RATIO

STEP = 1e-5  # metres, the step of the integers in a file that we write, where the extent leaves room for it


def read_las(data: bytes) -> Fields:
    """Read every dimension of the points under its name: x, y, z in metres, intensity, classification, ..."""
    laspy = _laspy()
    if data[:4] != b"LASF" or len(data) < 227:
        raise Malformed("does not begin as a .las or .laz file")
    row_bytes, n_points = struct.unpack_from("<HI", data, 105)
    if data[25] >= 4 and len(data) >= 375:
        (n_points,) = struct.unpack_from("<Q", data, 247)
    (start,) = struct.unpack_from("<I", data, 96)
    packed = bool(data[104] & 0x80)
    check_room(n_points, row_bytes, (len(data) - start) * (RATIO if packed else 1))
    try:
        las = laspy.read(io.BytesIO(data))
        fields: Fields = {axis: np.array(las[axis], dtype=np.float64) for axis in "xyz"}
        return fields | {name: np.array(las[name]) for name in las.point_format.dimension_names if name not in "XYZ"}
    except Exception as error:  # laspy and its unpackers raise errors of many kinds on damaged files
        raise Malformed(f"{' '.join(str(error).split())[:120]}; expected a whole .las or .laz file") from None


def write_las(file: BinaryIO, fields: Fields, *, packed: bool = False) -> None:
    """Write points of format 0 in steps of STEP metres, wider where they lie far apart, with the columns as extras."""
    laspy = _laspy()
    header = laspy.LasHeader(point_format=0, version="1.4")
    points = np.stack([fields[axis] for axis in "xyz"], axis=1)  # (N, 3)
    header.offsets = points.min(axis=0)
    with np.errstate(over="ignore"):
        extent = np.ptp(points, axis=0)
    if not np.isfinite(extent).all():
        raise Malformed(f"the points lie {extent.max()} m apart; expected less, or a .npz")
    header.scales = np.maximum(STEP, extent / (2**31 - 2))  # 32-bit integers, and room for rounding
    extra = {name: column for name, column in fields.items() if name not in ("x", "y", "z")}
    if taken := sorted(set(extra) & {*header.point_format.dimension_names, "x", "y", "z"}):
        raise Malformed(f"column {taken[0]!r} has a meaning of its own in a .las file; expected another name")
    for name, column in extra.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=column.dtype))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    for name, column in extra.items():
        las[name] = column
    whole = io.BytesIO()
    las.write(whole, do_compress=packed)
    file.write(whole.getvalue())


def write_laz(file: BinaryIO, fields: Fields) -> None:
    """Write as `write_las`, packed."""
    write_las(file, fields, packed=True)


def _laspy() -> Any:
    try:
        import laspy
    except ImportError:
        raise Malformed('.las and .laz need laspy; expected it to be there: pip install "laspy[lazrs]"') from None
    return laspy
