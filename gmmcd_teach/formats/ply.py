"""The polygon format of Stanford: .ply, ascii and binary of both endians (Turk 1994)."""

from __future__ import annotations

import io
import itertools
from dataclasses import dataclass, field
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
from gmmcd_teach.formats.text import parse_rows

NAMES = {
    "int8": "char",
    "uint8": "uchar",
    "int16": "short",
    "uint16": "ushort",
    "int32": "int",
    "uint32": "uint",
}
NAMES |= {
    "float32": "float",
    "float64": "double",
}  # NumPy's name -> PLY's; later writers use NumPy's
TYPES = {spelling: np.dtype(name) for name, old in NAMES.items() for spelling in (name, old)}
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class Element:
    """One `element` of the header: how many rows, the type of each property, and whether one is a list."""

    name: str
    count: int
    types: dict[str, np.dtype[Any]] = field(default_factory=dict)
    has_list: bool = False


def read_ply(data: bytes) -> Fields:
    """Read every property of the element `vertex`, each (N,); other elements (faces, edges) are passed over."""
    encoding, elements, start = _read_header(data)
    before = list(itertools.takewhile(lambda element: element.name != "vertex", elements))
    if len(before) == len(elements):
        raise Malformed("no element 'vertex' in the header; expected one with x, y and z")
    vertex = elements[len(before)]
    if vertex.has_list or not vertex.types:
        raise Malformed("vertices with list properties, or none at all; expected plain numbers x, y and z")
    if encoding == "ascii":
        first = sum(element.count for element in before)
        check_room(first + vertex.count, 1, len(data) - start, "rows")
        lines = (line for line in io.BytesIO(data[start:]) if not line.isspace())
        table = parse_rows(itertools.islice(lines, first, first + vertex.count))
        if table.shape != (vertex.count, len(vertex.types)):
            raise Malformed(
                f"the header announces {vertex.count} vertices of {len(vertex.types)} numbers; "
                f"found {' of '.join(map(str, table.shape))}"
            )
        return {name: to_type(table[:, i], dtype, name) for i, (name, dtype) in enumerate(vertex.types.items())}
    if any(element.has_list for element in before):
        raise Malformed("list properties before the vertices; expected the element 'vertex' first")
    skipped = sum(element.count * sum(dtype.itemsize for dtype in element.types.values()) for element in before)
    order = FORMATS[encoding]
    row = np.dtype([(str(i), order + dtype.str[1:]) for i, dtype in enumerate(vertex.types.values())])
    check_room(vertex.count, row.itemsize, len(data) - start - skipped)
    rows = np.frombuffer(data, row, vertex.count, start + skipped)
    return {name: rows[str(i)].astype(dtype) for i, (name, dtype) in enumerate(vertex.types.items())}


def _read_header(data: bytes) -> tuple[str, list[Element], int]:
    """Return the encoding, the elements in order and where the rows begin."""
    encoding = ""
    elements: list[Element] = []
    for number, (words, start) in enumerate(header_lines(data)):
        match words:
            case ["ply"] if number == 0:
                pass
            case _ if number == 0:
                raise Malformed("does not begin with 'ply'; expected a .ply file")
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if kind in FORMATS:
                encoding = kind
            case ["element", name, count]:
                elements.append(
                    Element(
                        name,
                        whole_number(count, f"the number of rows of {name[:40]!r}"),
                    )
                )
            case ["property", "list", _, _, _] if elements:
                elements[-1].has_list = True
            case ["property", kind, name] if elements and kind in TYPES and name not in elements[-1].types:
                elements[-1].types[name] = TYPES[kind]
            case ["end_header"] if encoding:
                return encoding, elements, start
            case _:
                raise Malformed(f"header line {' '.join(words)[:60]!r}; expected a .ply header of version 1.0")
    raise AssertionError("header_lines ends by raising")


def write_ply(file: BinaryIO, fields: Fields) -> None:
    """Write one-dimensional fields as the vertices of a binary little-endian .ply; 64-bit integers must fit 32."""
    columns = {name: _storable(name, column) for name, column in fields.items()}
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(columns['x'])}",
    ]
    lines += [f"property {NAMES[column.dtype.name]} {name}" for name, column in columns.items()]
    file.write("\n".join([*lines, "end_header", ""]).encode("ascii"))
    file.write(as_rows(columns).tobytes())


def _storable(name: str, column: NDArray[Any]) -> NDArray[Any]:
    if column.dtype.name not in NAMES:
        for narrow in ("int32", "uint32"):
            if column.min() >= np.iinfo(narrow).min and column.max() <= np.iinfo(narrow).max:
                return column.astype(narrow)
        raise Malformed(f"column {name!r} holds integers beyond 32 bits; expected smaller ones, or a .npz")
    return column
