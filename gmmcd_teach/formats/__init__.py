"""One module per file format: bytes in, named columns out (chapter 18). `clouds` picks the module by suffix.

A reader never trusts a header: what a file announces is compared with the bytes that it holds before memory is
taken, nothing is evaluated or unpickled, and whatever is wrong is said in one `Malformed` sentence.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Fields = dict[str, NDArray[Any]]  # column name -> (N,), (N, k) or, for an organised cloud, (H, W)

HEADER_LIMIT = 65536  # bytes; the longest header in the wild is a few hundred


class Malformed(ValueError):
    """What is wrong with a file's content, without the file's name."""


def header_lines(data: bytes) -> Iterator[tuple[list[str], int]]:
    """Yield the words of each header line with the offset of the byte after it; running out of lines is `Malformed`."""
    start = 0
    while (end := data.find(b"\n", start, HEADER_LIMIT)) >= 0:
        yield data[start:end].decode("latin-1").split(), end + 1
        start = end + 1
    raise Malformed("the header has no end; the file is truncated or of another format")


def whole_number(text: str, what: str) -> int:
    """Return the non-negative integer that `text` spells."""
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise Malformed(f"{what} is {text[:40]!r}; expected a whole number")
    return int(text)


def check_room(n_rows: int, row_bytes: int, available: int, unit: str = "points") -> None:
    """Refuse a header that announces no rows, or more than the bytes that are there can hold."""
    if n_rows == 0:
        raise Malformed(f"holds 0 {unit}; at least 1 needed")
    if (needed := n_rows * row_bytes) > available:
        raise Malformed(f"truncated: {n_rows} {unit} announced, at least {needed} bytes; found {max(available, 0)}")


def to_type(column: NDArray[np.float64], dtype: np.dtype[Any], name: str) -> NDArray[Any]:
    """Give a column read from text its announced integer type; floating point keeps every digit of the text."""
    if dtype.kind == "f":
        return column
    limits = np.iinfo(dtype)
    fits = (column >= float(limits.min)) & (column <= float(limits.max)) & (column == np.floor(column))
    if not fits.all():
        raise Malformed(f"field {name!r} holds {column[~fits][0]:g}; expected whole numbers that fit {dtype.name}")
    with np.errstate(invalid="ignore"):  # 2^63 and 2^64 pass as floats, one past the end
        return column.astype(dtype)


def as_rows(fields: Fields) -> NDArray[Any]:
    """Return one-dimensional columns side by side as one structured array (N,), little-endian."""
    rows = np.empty(
        len(fields["x"]),
        [(name, column.dtype.newbyteorder("<")) for name, column in fields.items()],
    )
    for name, column in fields.items():
        rows[name] = column
    return rows
