"""Tables of numbers as text: .xyz and .csv, and the rows of ascii .ply and .pcd."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterable, Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from gmmcd_teach.formats import HEADER_LIMIT, Fields, Malformed, as_rows

DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+\s*[; \t]\s*[-+]?\d+,\d")


def parse_rows(lines: Iterable[bytes], delimiter: str | None = None, start: int = 0) -> NDArray[np.float64]:
    """Return lines of numbers as a table (rows, columns); blank lines are skipped.

    `start` is the number in the file of the first line, for messages; where it is 0 they count rows from 1 on.
    """
    number = (start or 1) - 1

    def texts() -> Iterator[str]:
        nonlocal number
        for line in lines:
            number += 1
            if (text := line.decode("latin-1")).strip():
                yield text

    rows = texts()
    first = next(rows, None)
    if first is None:
        raise Malformed("holds 0 points; at least 1 needed")
    try:
        return np.loadtxt(itertools.chain([first], rows), delimiter=delimiter, comments=None, ndmin=2)
    except ValueError as error:
        reason = re.sub(r" at row \d+", "", str(error).split(";")[0].rstrip("."))[:120]
        where = f"{'line' if start else 'row'} {number}"
        raise Malformed(f"{where}: {reason}; expected numbers only, equally many in every row") from None


def read_text(data: bytes) -> Fields:
    """Read rows `x y z ...` between blanks, tabs, commas or semicolons.

    The rows may follow comments (# or //) and one line of column names; a comment may also name the columns.
    Columns without a name are x, y, z, column_3, column_4, ... The coordinates may be named in capitals.
    """
    data = _plain(data)
    heading = comment = ""
    start = 0
    while True:
        end = data.find(b"\n", start) + 1 or len(data)
        line = data[start:end].decode("latin-1").strip()
        if start == len(data):
            raise Malformed("holds 0 points; at least 1 needed")
        if DECIMAL_COMMA.match(line):
            raise Malformed(f"{line[:40]!r} has decimal commas; expected decimal points")
        if line.startswith(("#", "//")):
            comment = line.lstrip("#/").strip()
        elif line and _is_number(_split(line)[0]):
            break
        elif line and heading:
            raise Malformed(f"{line[:40]!r} stands where numbers belong; expected rows x y z ...")
        else:
            heading = heading or line
        start = end
    table = parse_rows(
        itertools.islice(io.BytesIO(data), above := data.count(b"\n", 0, start), None),
        _delimiter(line),
        above + 1,
    )
    n_columns = table.shape[1]
    names = [word.strip('"') for word in _split(heading or comment)]
    if not {"x", "y", "z"} <= set(names):
        names = [name.lower() if name in ("X", "Y", "Z") else name for name in names]
    if heading and len(names) != n_columns:
        raise Malformed(f"{len(names)} column names over {n_columns} columns; expected one name for each")
    if len(names) != n_columns or not (heading or {"x", "y", "z"} <= set(names)):
        names = [*"xyz", *(f"column_{i}" for i in range(3, n_columns))][:n_columns]
    if len(set(names)) != n_columns:
        raise Malformed("two columns have the same name; expected different names")
    return dict(zip(names, table.T, strict=True))


def _plain(data: bytes) -> bytes:
    """The text in one byte a character, with one mark at the end of each line."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        try:
            data = data.decode("utf-16").encode()
        except UnicodeDecodeError:
            raise Malformed("not whole UTF-16; expected rows of numbers as plain text") from None
    if b"\0" in data[:HEADER_LIMIT]:
        raise Malformed("holds bytes of zero, so it is no plain text; expected rows of numbers as text")
    data = data.removeprefix(b"\xef\xbb\xbf")
    return data if b"\n" in data else data.replace(b"\r", b"\n")


def _delimiter(line: str) -> str | None:
    return next((mark for mark in ";,\t" if mark in line), None)


def _split(line: str) -> list[str]:
    return [word.strip() for word in line.split(_delimiter(line))]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def write_xyz(file: BinaryIO, fields: Fields) -> None:
    """Write rows between blanks; the names of per-point columns stand in a comment."""
    _write(file, fields, " ", "# " + " ".join(fields) + "\n" if len(fields) > 3 else "")


def write_csv(file: BinaryIO, fields: Fields) -> None:
    """Write rows between commas under a line of column names."""
    _write(file, fields, ",", ",".join(fields) + "\n")


def _write(file: BinaryIO, fields: Fields, delimiter: str, heading: str) -> None:
    file.write(heading.encode("ascii"))
    formats = ["%.17g" if column.dtype.kind == "f" else "%d" for column in fields.values()]
    np.savetxt(file, as_rows(fields), fmt=formats, delimiter=delimiter)
