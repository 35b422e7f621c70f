"""The point cloud format of PCL: .pcd, ascii, binary and binary_compressed (PCD 0.7)."""

from __future__ import annotations

import io
import struct
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.formats import (
    Fields,
    Malformed,
    as_rows,
    check_room,
    header_lines,
    to_type,
    whole_number,
)
from gmmcd_teach.formats.lzf import RATIO, decompress
from gmmcd_teach.formats.text import parse_rows

TYPES = {f"{kind}{size}" for kind, sizes in (("F", "48"), ("I", "1248"), ("U", "1248")) for size in sizes}
ROUNDING = 1e-5  # m
Layout = list[tuple[str, np.dtype[Any], int]]  # name, type and COUNT of each field


def read_pcd(data: bytes) -> Fields:
    """Read every field; those of an organised cloud (HEIGHT > 1) have the shape of its image, (H, W).

    A field of COUNT k > 1 has a last axis of k. Padding, fields named "_", is left out.
    """
    header: dict[str, list[str]] = {}
    lines = header_lines(data)
    while "DATA" not in header:
        words, start = next(lines)
        header |= {words[0]: words[1:]} if words else {}
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT"):
        if not header.get(key):
            raise Malformed(f"no {key} in the header; expected a .pcd of version 0.7")
    layout = _layout(header)
    width, height = (whole_number(header[key][0], key) for key in ("WIDTH", "HEIGHT"))
    n_points = width * height
    if header.get("POINTS", [str(n_points)]) != [str(n_points)]:
        raise Malformed(f"POINTS is not WIDTH times HEIGHT = {n_points}; expected them to agree")
    encoding = " ".join(header["DATA"])
    if encoding not in READERS:
        raise Malformed(f"DATA is {encoding[:40]!r}; expected one of {', '.join(READERS)}")
    columns = READERS[encoding](data[start:], n_points, layout)
    image = (height, width) if height > 1 else (width,)
    return {
        name: column.reshape(image if count == 1 else (*image, count))
        for (name, _, count), column in zip(layout, columns, strict=True)
        if name != "_"
    }


def _layout(header: dict[str, list[str]]) -> Layout:
    names = header["FIELDS"]
    types = [kind + size for kind, size in zip(header["TYPE"], header["SIZE"], strict=False)]
    counts = [whole_number(word, "COUNT") for word in header.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(header["TYPE"]) == len(header["SIZE"]) == len(counts) or 0 in counts:
        raise Malformed(
            "FIELDS, SIZE, TYPE and COUNT do not match; expected one entry for each field, COUNT at least 1"
        )
    if any(name in ("x", "y", "z") and count != 1 for name, count in zip(names, counts, strict=True)):
        raise Malformed("COUNT of x, y or z is not 1; expected one number for each coordinate")
    if unknown := set(types) - TYPES:
        raise Malformed(f"field type {min(unknown)[:40]!r}; expected F of size 4 or 8, I or U of size 1, 2, 4 or 8")
    named = [name for name in names if name != "_"]
    if len(set(named)) != len(named):
        raise Malformed("two fields have the same name; expected different names")
    return [(name, np.dtype(f"<{kind.lower()}"), count) for name, kind, count in zip(names, types, counts, strict=True)]


def _read_ascii(body: bytes, n_points: int, layout: Layout) -> list[NDArray[Any]]:
    """Rows of numbers, one point each."""
    ends = np.cumsum([count for _, _, count in layout])
    check_room(n_points, 2 * int(ends[-1]) - 1, len(body))
    table = parse_rows(io.BytesIO(body))
    if table.shape != (n_points, ends[-1]):
        raise Malformed(
            f"the header announces {n_points} rows of {ends[-1]} numbers; found {' of '.join(map(str, table.shape))}"
        )
    return [
        to_type(table[:, end - count : end], dtype, name)
        for end, (name, dtype, count) in zip(ends, layout, strict=True)
    ]


def _read_binary(body: bytes, n_points: int, layout: Layout) -> list[NDArray[Any]]:
    """Point after point, the fields of each side by side."""
    check_room(n_points, _row_bytes(layout), len(body))
    row = np.dtype([(str(i), dtype, (count,)) for i, (_, dtype, count) in enumerate(layout)])
    rows = np.frombuffer(body, row, n_points)
    return [rows[name] for name in rows.dtype.names or ()]


def _read_compressed(body: bytes, n_points: int, layout: Layout) -> list[NDArray[Any]]:
    """Two sizes, packed and unpacked, then LZF; unpacked, field after field, the points of each side by side."""
    if len(body) < 8:
        raise Malformed("truncated: no compressed data follow the header")
    packed, unpacked = struct.unpack_from("<II", body)
    check_room(n_points, _row_bytes(layout), RATIO * packed)
    if packed > len(body) - 8:
        raise Malformed(f"truncated: {packed} bytes of compressed data announced; {len(body) - 8} follow")
    if unpacked != n_points * _row_bytes(layout):
        raise Malformed(f"{unpacked} unpacked bytes announced; expected {n_points * _row_bytes(layout)} for the fields")
    block = decompress(body[8 : 8 + packed], unpacked)
    columns = []
    start = 0
    for _, dtype, count in layout:
        columns.append(np.frombuffer(block, dtype, n_points * count, start).reshape(n_points, count))
        start += columns[-1].nbytes
    return columns


def _row_bytes(layout: Layout) -> int:
    return sum(dtype.itemsize * count for _, dtype, count in layout)


READERS = {
    "ascii": _read_ascii,
    "binary": _read_binary,
    "binary_compressed": _read_compressed,
}


def write_pcd(file: BinaryIO, fields: Fields) -> None:
    """Write one-dimensional fields as a binary .pcd, every number in the type that it has.

    Coordinates are the exception: most readers know them as float32 only, so that they are written where it moves
    no point by more than ROUNDING.
    """
    with np.errstate(over="ignore"):
        rounded: Fields = {axis: fields[axis].astype(np.float32) for axis in ("x", "y", "z")}
    if max(np.abs(rounded[axis] - fields[axis]).max() for axis in rounded) <= ROUNDING:
        fields = fields | rounded
    types = [column.dtype for column in fields.values()]
    header = {
        "VERSION": "0.7",
        "FIELDS": " ".join(fields),
        "SIZE": " ".join(str(dtype.itemsize) for dtype in types),
        "TYPE": " ".join(dtype.kind.upper() for dtype in types),
        "COUNT": " ".join("1" for _ in types),
        "WIDTH": len(fields["x"]),
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": len(fields["x"]),
        "DATA": "binary",
    }
    file.write("".join(f"{key} {value}\n" for key, value in header.items()).encode("ascii"))
    file.write(as_rows(fields).tobytes())
