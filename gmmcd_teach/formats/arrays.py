"""NumPy's own files: .npy, one array, and .npz, a zip of several; no pickle, and no header is evaluated."""

from __future__ import annotations

import io
import math
import re
import struct
import zipfile
import zlib
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.formats import Fields, Malformed, check_room

HEADER = re.compile(
    rb"\{'descr': '([<>|=]?f[248]|[<>|=]?[iu][1248]|\|b1)', 'fortran_order': (False|True), "
    rb"'shape': \(((?:[0-9]{1,18}, ?)*[0-9]{0,18})\),? ?\} *\n"
)
RATIO = 100  # a .npz may unpack to this many times its size,
FLOOR = 1 << 24  # or to 16 MiB


def parse_array(data: bytes) -> NDArray[Any]:
    """Return the plain numeric array of a .npy file; nothing else that a .npy can hold is accepted."""
    if data[:6] != b"\x93NUMPY" or data[6:8] not in (b"\x01\x00", b"\x02\x00"):
        raise Malformed("does not begin as a .npy of version 1 or 2")
    width = 2 if data[6] == 1 else 4
    start = 8 + width + int.from_bytes(data[8 : 8 + width], "little")
    header = HEADER.fullmatch(data, 8 + width, start) if start <= len(data) else None
    if header is None:
        raise Malformed("not a plain array of numbers; expected floats, integers or booleans")
    descr, fortran, sizes = (group.decode("ascii") for group in header.groups())
    shape = tuple(int(size) for size in sizes.split(",") if size.strip())
    dtype = np.dtype(descr)
    check_room(math.prod(shape), dtype.itemsize, len(data) - start, "numbers")
    array = np.frombuffer(data, dtype, math.prod(shape), start)
    return array.reshape(shape, order="F" if fortran == "True" else "C")


def read_npy(data: bytes) -> Fields:
    """Read an array (N, C), C >= 3, as columns x, y, z, column_3, ...; three rows of more columns lie on their side."""
    array = parse_array(data)
    if array.ndim != 2 or array.shape[1] < 3:
        raise Malformed(f"an array of shape {array.shape}; expected (N, 3) in metres")
    if array.shape[0] == 3 < array.shape[1]:
        raise Malformed(f"an array of shape {array.shape}; expected (N, 3) in metres: transpose it")
    return dict(
        zip(
            ["x", "y", "z", *(f"column_{i}" for i in range(3, array.shape[1]))],
            array.T,
            strict=True,
        )
    )


def read_npz(data: bytes) -> Fields:
    """Read `points` (N, 3), or else the only (N, 3) array, as x, y and z; other arrays of N rows keep their names."""
    arrays = read_members(data)
    if not {"x", "y", "z"} <= set(arrays):
        tables = [name for name, array in arrays.items() if array.ndim == 2 and array.shape[1] == 3]
        if "points" not in tables and len(tables) != 1:
            raise Malformed(f"holds {', '.join(arrays)[:200] or 'nothing'}; expected an array 'points' of shape (N, 3)")
        points = arrays.pop("points" if "points" in tables else tables[0])
        arrays = dict(zip("xyz", points.T, strict=True)) | arrays
    return {name: array for name, array in arrays.items() if array.shape[:1] == arrays["x"].shape}


def read_members(data: bytes) -> dict[str, NDArray[Any]]:
    """Read every array of a .npz by its name, refusing one that would unpack to far more than its size."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            unpacked = sum(member.file_size for member in members)
            if unpacked > max(RATIO * len(data), FLOOR):
                raise Malformed(f"unpacks to {unpacked} bytes, over {RATIO} times its own size; expected a cloud")
            if any(member.flag_bits & 1 or member.compress_type not in (0, 8) for member in members):
                raise Malformed("encrypted, or packed otherwise than by deflate; expected a file of numpy.savez")
            return {member.filename.removesuffix(".npy"): _read_member(archive, member) for member in members}
    except (
        zipfile.BadZipFile,
        zlib.error,
        struct.error,
        EOFError,
        NotImplementedError,
        OSError,
        ValueError,
    ) as error:
        if isinstance(error, Malformed):
            raise
        raise Malformed(f"a damaged archive ({str(error)[:80]}); expected a file of numpy.savez") from None


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        data = file.read(member.file_size)
    try:
        return parse_array(data)
    except Malformed as problem:
        raise Malformed(f"member {member.filename[:40]!r}: {problem}") from None


def write_npy(file: BinaryIO, fields: Fields) -> None:
    """Write x, y, z as one array (N, 3)."""
    if len(fields) > 3:
        raise Malformed("a .npy has no names for per-point columns; expected none, or a .npz")
    np.lib.format.write_array(file, np.column_stack([fields[axis] for axis in "xyz"]), allow_pickle=False)


def write_npz(file: BinaryIO, fields: Fields) -> None:
    """Write `points` (N, 3) and each per-point column under its name."""
    arrays = {"points": np.column_stack([fields[axis] for axis in "xyz"])}
    arrays |= {name: column for name, column in fields.items() if name not in ("x", "y", "z")}
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
