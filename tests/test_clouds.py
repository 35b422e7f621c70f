"""Reading and writing clouds: every format against another reader or a file made by hand, and every refusal."""

import io
import os
import re
import struct
import time
import tracemalloc
import zipfile
from collections import Counter
from pathlib import Path
from random import Random
from unittest import mock

import numpy as np
import plyfile
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gmmcd_teach.clouds import CloudError, check_points, read_cloud, read_fields, write_cloud
from gmmcd_teach.formats import Malformed
from gmmcd_teach.formats.lzf import decompress

POINTS = np.array([[0.1, -2.0, 3.5], [1e-7, 4.25, -0.5], [7.0, 8.0, 9.0]])
SUFFIXES = [".ply", ".pcd", ".xyz", ".csv", ".npy", ".npz"]
FILTERS = Path(__file__).parents[2] / "shared/real/filters"


def compress(data: bytes) -> bytes:
    """LZF as its format note has it: the longest match among the last places where three bytes stood."""
    out, literals, seen, i = bytearray(), bytearray(), {}, 0

    def flush():
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            out.extend([len(run) - 1, *run])
        literals.clear()

    while i < len(data):
        start = seen.get(data[i : i + 3], -1) if i + 3 <= len(data) else -1
        seen[data[i : i + 3]] = i
        if start < 0 or i - start > 8192:
            literals.append(data[i])
            i += 1
            continue
        length = 3
        while length < 264 and i + length < len(data) and data[start + length] == data[i + length]:
            length += 1
        flush()
        back, short = i - start - 1, length - 2
        out.extend([short << 5 | back >> 8] if short < 7 else [7 << 5 | back >> 8, short - 7])
        out.append(back & 255)
        i += length
    flush()
    return bytes(out)


def pcd(encoding: str, body: bytes, n: int = 3, fields: str = "x y z label", extra: str = "") -> bytes:
    kinds = " ".join("U" if name == "label" else "F" for name in fields.split())
    sizes = " ".join("4" for _ in fields.split())
    counts = " ".join("1" for _ in fields.split())
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\nCOUNT {counts}\n"
        f"WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\n{extra}DATA {encoding}\n"
    ).encode() + body


def ply(fmt: str, body: bytes, n: int = 3, before: str = "", after: str = "", kind: str = "double") -> bytes:
    properties = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    return f"ply\nformat {fmt} 1.0\n{before}element vertex {n}\n{properties}{after}end_header\n".encode() + body


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npz(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()


RECORDS = np.zeros(3, [(axis, "<f4") for axis in "xyz"] + [("label", "<u4")])
for _i, _axis in enumerate("xyz"):
    RECORDS[_axis] = POINTS[:, _i]
RECORDS["label"] = [0, 41, 2**32 - 1]
BY_FIELD = b"".join(RECORDS[name].tobytes() for name in RECORDS.dtype.names)
PACKED = compress(BY_FIELD)
TEXT = b"".join(b" ".join(str(v).encode() for v in row) + b"\n" for row in RECORDS.tolist())
ROWS = b"".join(b" ".join(repr(float(v)).encode() for v in row) + b"\n" for row in POINTS)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(tmp_path, suffix):
    write_cloud(tmp_path / f"cloud{suffix}", POINTS)
    np.testing.assert_allclose(read_cloud(tmp_path / f"cloud{suffix}"), POINTS, rtol=1e-7 if suffix == ".pcd" else 0)
    assert os.listdir(tmp_path) == [f"cloud{suffix}"]


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix != ".npy"])
def test_columns_come_back_with_their_values(tmp_path, suffix):
    columns = {
        "label": np.array([-5, 0, 2**31 - 1]),
        "changed": np.array([True, False, True]),
        "weight": np.array([0.1, 1e-30, 3e8], dtype=np.float32),
        "tiny": np.array([1, 2, 255], dtype=np.uint8),
        "half": np.array([0.5, 1, 2], dtype=np.float16),
    }
    write_cloud(tmp_path / f"cloud{suffix}", POINTS, **columns)
    fields = read_fields(tmp_path / f"cloud{suffix}")
    assert list(fields) == ["x", "y", "z", *columns]
    for name, column in columns.items():
        np.testing.assert_array_equal(fields[name], column)
    if suffix in (".ply", ".pcd", ".npz"):  # what the formats cannot hold becomes the least that can
        kept = {"changed": bool, "half": np.float16} if suffix == ".npz" else {"changed": np.uint8, "half": np.float32}
        assert {name: fields[name].dtype for name in kept} == kept


def test_npz_takes_columns_of_several_numbers(tmp_path):
    colours = np.arange(9, dtype=np.uint8).reshape(3, 3)
    write_cloud(tmp_path / "cloud.npz", POINTS, colour=colours, file=[1, 2, 3])
    fields = read_fields(tmp_path / "cloud.npz")
    np.testing.assert_array_equal(fields["colour"], colours)
    np.testing.assert_array_equal(fields["file"], [1, 2, 3])


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_any_finite_numbers_round_trip(tmp_path_factory, suffix, data):
    finite = st.floats(allow_nan=False, allow_infinity=False)
    points = data.draw(hnp.arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=finite))
    path = tmp_path_factory.mktemp("any") / f"cloud{suffix}"
    write_cloud(path, points)
    np.testing.assert_allclose(read_cloud(path), points, rtol=0, atol=1e-5 if suffix == ".pcd" else 0)


def test_far_cloud_keeps_its_digits_in_pcd(tmp_path):
    far = POINTS + np.array([5e5, 5.4e6, 0])
    write_cloud(tmp_path / "far.pcd", far)
    np.testing.assert_array_equal(read_cloud(tmp_path / "far.pcd"), far)


def test_plyfile_reads_what_we_write(tmp_path):
    write_cloud(tmp_path / "cloud.ply", POINTS, label=[1, 2, 3])
    vertex = plyfile.PlyData.read(tmp_path / "cloud.ply")["vertex"]
    np.testing.assert_array_equal(np.column_stack([vertex[axis] for axis in "xyz"]), POINTS)
    np.testing.assert_array_equal(vertex["label"], [1, 2, 3])


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("order", ["<", ">"])
def test_we_read_what_plyfile_writes(tmp_path, text, order):
    vertices = np.zeros(3, [("red", "u1"), ("x", "f4"), ("y", "f8"), ("z", "f4"), ("label", "i2")])
    for i, axis in enumerate("xyz"):
        vertices[axis] = POINTS[:, i]
    vertices["red"], vertices["label"] = [0, 128, 255], [-32768, 0, 32767]
    faces = np.array([([0, 1, 2], 5)], dtype=[("vertex_indices", "i4", (3,)), ("flags", "u1")])
    elements = [plyfile.PlyElement.describe(vertices, "vertex"), plyfile.PlyElement.describe(faces, "face")]
    plyfile.PlyData(elements, text=text, byte_order=order, comments=["made for a test"]).write(tmp_path / "a.ply")
    fields = read_fields(tmp_path / "a.ply")
    for name in vertices.dtype.names:
        np.testing.assert_allclose(fields[name], vertices[name], rtol=1e-7)
    assert fields["label"].dtype == np.int16


@pytest.mark.parametrize("text", [True, False])
def test_elements_before_the_vertices_are_passed_over(tmp_path, text):
    first = np.array([(1, 2.5), (3, 4.5)], dtype=[("a", "i4"), ("b", "f8")])
    vertices = np.array([tuple(row) for row in POINTS], dtype=[(axis, "f8") for axis in "xyz"])
    elements = [plyfile.PlyElement.describe(first, "camera"), plyfile.PlyElement.describe(vertices, "vertex")]
    plyfile.PlyData(elements, text=text).write(tmp_path / "a.ply")
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.ply"), POINTS)


@pytest.mark.parametrize(
    ("encoding", "body"),
    [
        ("ascii", TEXT),
        ("binary", RECORDS.tobytes()),
        ("binary_compressed", struct.pack("<II", len(PACKED), len(BY_FIELD)) + PACKED),
    ],
    ids=["ascii", "binary", "binary_compressed"],
)
def test_pcd_encodings(tmp_path, encoding, body):
    (tmp_path / "a.pcd").write_bytes(pcd(encoding, body))
    fields = read_fields(tmp_path / "a.pcd")
    np.testing.assert_allclose(read_cloud(tmp_path / "a.pcd"), POINTS, rtol=1e-7)
    np.testing.assert_array_equal(fields["label"], [0, 41, 2**32 - 1])
    assert fields["label"].dtype == np.uint32


def test_organised_pcd_with_padding_and_vectors(tmp_path):
    record = np.zeros(6, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("pad", "u1", (3,)), ("h", "<i2", (2,))])
    record["x"] = np.arange(6)
    record["z"][4] = np.nan
    record["h"] = np.arange(12).reshape(6, 2)
    header = "FIELDS x y z _ h\nSIZE 4 4 4 1 2\nTYPE F F F U I\nCOUNT 1 1 1 3 2\nWIDTH 3\nHEIGHT 2\nPOINTS 6\n"
    (tmp_path / "a.pcd").write_bytes(f"{header}DATA binary\n".encode() + record.tobytes())
    fields = read_fields(tmp_path / "a.pcd")
    assert list(fields) == ["x", "y", "z", "h"]
    np.testing.assert_array_equal(fields["x"], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(fields["h"][1, 2], [10, 11])
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pcd")[:, 0], [0, 1, 2, 3, 5])


@pytest.mark.parametrize(
    ("suffix", "text", "columns"),
    [
        (".xyz", "1 2 3\n4 5 6\n", ["x", "y", "z"]),
        (".xyz", "\n# a comment\n1\t2\t3\t7\n\n4\t5\t6\t8", ["x", "y", "z", "column_3"]),
        (".xyz", "# label x y z\n7 1 2 3\n8 4 5 6\n", ["label", "x", "y", "z"]),
        (".xyz", "//X Y Z\r\n1 2 3\r\n4 5 6\r\n", ["x", "y", "z"]),
        (".csv", "x,y,z\n1,2,3\n4,5,6\n", ["x", "y", "z"]),
        (".csv", '"Label";"X";"Y";"Z"\n7; 1; 2; 3\n8; 4; 5; 6\n', ["Label", "x", "y", "z"]),
        (".csv", "\ufeffx,y,z,note\n1,2,3,nan\n4,5,6,1e3\n", ["x", "y", "z", "note"]),
        (".csv", "1,2,3\n4,5,6", ["x", "y", "z"]),
        (".csv", "# two rows\n1, 2, 3\n4, 5, 6\n", ["x", "y", "z"]),
        (".csv", "x,y,z,X\n1,2,3,7\n4,5,6,8\n", ["x", "y", "z", "X"]),
        (".csv", "x,y,z\r1,2,3\r4,5,6\r", ["x", "y", "z"]),
        (".csv", "1,2 ,3 ,4\n4,5 ,6 ,7\n", ["x", "y", "z", "column_3"]),
    ],
    ids=range(12),
)
def test_text_tables(tmp_path, suffix, text, columns):
    (tmp_path / f"a{suffix}").write_bytes(text.encode())
    assert list(read_fields(tmp_path / f"a{suffix}")) == columns
    np.testing.assert_array_equal(read_cloud(tmp_path / f"a{suffix}"), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("order", ["utf-16", "utf-16-be"])
def test_text_of_two_bytes_a_character(tmp_path, order):
    mark = b"\xfe\xff" if order == "utf-16-be" else b""
    (tmp_path / "a.csv").write_bytes(mark + "x;y;z\r\n1;2;3\r\n".encode(order))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.csv"), [[1, 2, 3]])


@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".npz", ".ply", ".pcd"])
def test_names_of_columns_keep_their_capitals(tmp_path, suffix):
    write_cloud(tmp_path / f"a{suffix}", POINTS, X=[7, 8, 9], Label=[1, 2, 3])
    np.testing.assert_allclose(read_cloud(tmp_path / f"a{suffix}"), POINTS, rtol=0, atol=1e-5)
    fields = read_fields(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(fields["X"], [7, 8, 9])
    np.testing.assert_array_equal(fields["Label"], [1, 2, 3])


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "<i2", "|u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_numpy_arrays_of_any_kind_and_order(tmp_path, dtype, order):
    array = np.array([[1, 2, 3, 7], [4, 5, 6, 8]], dtype=dtype, order=order)
    np.save(tmp_path / "a.npy", array)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy"), array[:, :3])
    np.savez_compressed(tmp_path / "a.npz", only=array[:, :3], label=array[:, 3], other=np.zeros(7))
    assert list(read_fields(tmp_path / "a.npz")) == ["x", "y", "z", "label"]
    np.savez(tmp_path / "b.npz", x=array[:, 0], y=array[:, 1], z=array[:, 2])
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.npz"), array[:, :3])


@pytest.mark.parametrize("suffix", [".xyz", ".npy", ".npz", ".ply", ".pcd", ".csv"])
def test_rows_with_nan_or_infinity_are_dropped(tmp_path, suffix):
    holes = np.vstack([POINTS, [[np.nan, 1, 2], [1, np.inf, 2], [1, 2, -np.inf]]])
    write_cloud(tmp_path / f"a{suffix}", np.vstack([POINTS, POINTS]))
    whole = (tmp_path / f"a{suffix}").read_bytes()
    if suffix in (".xyz", ".csv"):
        (tmp_path / f"a{suffix}").write_text("".join(",".join(map(str, row)) + "\n" for row in holes))
    elif suffix in (".npy", ".npz"):
        np.save(tmp_path / "a.npy", holes)
        np.savez(tmp_path / "a.npz", points=holes)
    else:
        dtype = "<f4" if suffix == ".pcd" else "<f8"
        body = holes.astype(dtype).tobytes()
        (tmp_path / f"a{suffix}").write_bytes(whole[: len(whole) - len(body)] + body)
    np.testing.assert_allclose(read_cloud(tmp_path / f"a{suffix}"), POINTS, rtol=1e-7)


def test_signalling_nan_is_a_nan(tmp_path):
    np.save(tmp_path / "a.npy", np.vstack([POINTS, POINTS]).astype("<f4"))
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data[:-4] + bytes.fromhex("010080ff"))
    assert read_cloud(tmp_path / "a.npy").shape == (5, 3)


@pytest.mark.skipif(not FILTERS.is_dir(), reason="needs ../shared/real/filters")
def test_files_of_pcl():
    assert read_cloud(FILTERS / "bun0.pcd").shape == (397, 3)
    assert read_cloud(FILTERS / "table_scene_mug_stereo_textured_noplane.pcd").shape == (23760, 3)


@given(st.lists(st.binary(max_size=40), max_size=20).map(lambda parts: b"".join(part * 9 for part in parts)))
def test_lzf_unpacks_what_was_packed(data):
    assert decompress(compress(data), len(data)) == data


BAD_FILES = {
    # a name, the content, what the message must say
    "empty.ply": (b"", "empty"),
    "empty.npz": (b"", "empty"),
    "other.ply": (pcd("ascii", TEXT), "does not begin with 'ply'"),
    "other.pcd": (ply("ascii", ROWS), "no end|no DATA|DATA|truncated"),
    "endless.ply": (b"ply\nformat ascii 1.0\n" + b"comment\n" * 20000, "no end"),
    "headless.ply": (b"ply\nformat ascii 1.0\nelement vertex 3\n", "no end"),
    "noformat.ply": (b"ply\nelement vertex 1\nproperty float x\nend_header\n1\n", "end_header"),
    "version.ply": (ply("ascii", ROWS).replace(b"1.0\n", b"2.0\n", 1), "format ascii 2.0"),
    "type.ply": (ply("ascii", ROWS, kind="quad"), "property quad x"),
    "novertex.ply": (ply("ascii", ROWS).replace(b"vertex", b"point"), "no element 'vertex'"),
    "listed.ply": (ply("ascii", ROWS).replace(b"property double z", b"property list uchar int z"), "list properties"),
    "before.ply": (
        ply("binary_little_endian", bytes(99), before="element face 1\nproperty list uchar int i\n"),
        "list properties before",
    ),
    "noz.ply": (
        ply("ascii", b"1 2\n" * 3).replace(b"property double z\n", b""),
        "no column 'z' among x, y; expected x, y and z",
    ),
    "short.ply": (ply("ascii", ROWS, n=4), "announces 4 vertices"),
    "cut.ply": (ply("binary_big_endian", POINTS.astype(">f8").tobytes()[:-1]), "truncated"),
    "billion.ply": (ply("binary_little_endian", POINTS.tobytes(), n=10**9), "1000000000 points announced"),
    "billion_text.ply": (ply("ascii", ROWS, n=10**9), "1000000000 rows announced"),
    "skip.ply": (ply("ascii", ROWS, before="element a 999999999999999999\n" * 20), "announced"),
    "skip_binary.ply": (
        ply("binary_little_endian", POINTS.tobytes(), before="element a 999999999999999999\nproperty int i\n"),
        "truncated",
    ),
    "zero.ply": (ply("binary_little_endian", b"", n=0), "0 points"),
    "zero_text.ply": (ply("ascii", b"", n=0), "0 points|0 rows"),
    "minus.ply": (ply("ascii", ROWS, n=-3), "whole number"),
    "digits.ply": (ply("ascii", ROWS, n="9" * 5000), "whole number"),
    "word.ply": (ply("ascii", b"1 2 three\n" * 3), "three"),
    "range.ply": (ply("ascii", b"1 2 300\n" * 3, kind="uchar"), "'z' holds 300"),
    "fraction.ply": (ply("ascii", b"1 2 2.5\n" * 3, kind="int"), "'z' holds 2.5"),
    "nan.ply": (ply("ascii", b"1 2 nan\n" * 3, kind="int"), "'z' holds nan"),
    "same.ply": (ply("ascii", ROWS, after="property float x\n"), "property float x"),
    "holes.ply": (ply("ascii", b"nan 0 0\ninf 0 0\n0 -inf 0\n"), "no point with three finite"),
    "cut.pcd": (pcd("binary", RECORDS.tobytes()[:-1]), "truncated"),
    "cut_text.pcd": (pcd("ascii", TEXT, n=4), "announces 4 rows"),
    "more.pcd": (pcd("ascii", TEXT, n=2), "announces 2 rows"),
    "billion.pcd": (pcd("binary", RECORDS.tobytes(), n=10**9), "1000000000 points announced"),
    "billion_text.pcd": (pcd("ascii", TEXT, n=10**9), "1000000000 points announced"),
    "billion_packed.pcd": (pcd("binary_compressed", struct.pack("<II", 9, 0) + bytes(9), n=10**9), "announced"),
    "packed_size.pcd": (pcd("binary_compressed", struct.pack("<II", 10**9, 48) + PACKED), "1000000000 bytes"),
    "unpacked_size.pcd": (pcd("binary_compressed", struct.pack("<II", len(PACKED), 49) + PACKED), "expected 48"),
    "packed_cut.pcd": (pcd("binary_compressed", struct.pack("<II", 9, 48) + PACKED[:9]), "unpack|end in the middle"),
    "packed_bad.pcd": (pcd("binary_compressed", struct.pack("<II", 4, 48) + b"\x20\xff\x00\x00"), "before their start"),
    "packed_none.pcd": (pcd("binary_compressed", b"1234"), "no compressed data"),
    "zero.pcd": (pcd("binary", b"", n=0), "0 points"),
    "data.pcd": (pcd("gzip", RECORDS.tobytes()), "ascii, binary, binary_compressed"),
    "nodata.pcd": (b"VERSION 0.7\nFIELDS x y z\n", "no end"),
    "nofields.pcd": (b"VERSION 0.7\nDATA ascii\n1 2 3\n", "no FIELDS"),
    "sizes.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"SIZE 4 4 4 4", b"SIZE 4 4 4"), "do not match"),
    "kind.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"TYPE F", b"TYPE Q"), "'Q4'"),
    "size3.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"SIZE 4", b"SIZE 3"), "'F3'"),
    "count0.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"COUNT 1", b"COUNT 0"), "COUNT"),
    "count2.pcd": (pcd("binary", RECORDS.tobytes() * 2).replace(b"COUNT 1", b"COUNT 2"), "COUNT of x"),
    "counts.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"1 1 1 1\n", b"1 1 1 999999999999999\n"), "truncated"),
    "shape.pcd": (pcd("binary", RECORDS.tobytes()).replace(b"HEIGHT 1", b"HEIGHT 2"), "POINTS is not"),
    "twice.pcd": (pcd("ascii", b"1 2 3 4\n" * 3, fields="x y z x"), "same name"),
    "noxyz.pcd": (pcd("ascii", b"1 2 3 4\n" * 3, fields="a b c d"), "no column 'x'"),
    "label.pcd": (pcd("ascii", b"1 2 3 -4\n" * 3), "'label' holds -4"),
    "ragged.xyz": (b"1 2 3\n4 5\n", "changed from 3 to 2"),
    "two.xyz": (b"1 2\n4 5\n", "no column 'z'"),
    "words.xyz": (b"hello world and\nall who live in it\n", "stands where numbers belong"),
    "later.xyz": (b"1 2 3\n4 five 6\n", "line 2: .*'five'.*, column 2; expected numbers only"),
    "under_a_heading.csv": (b"x,y,z\n1,2,3\n\n4,5,tea\n", "line 4: .*'tea'"),
    "ragged_heading.csv": (b"x,y,z\n1,2,3\n4,5\n", "line 3: the number of columns changed from 3 to 2;"),
    "named.xyz": (b"1 2 3 chair\n", "line 1: .*'chair'.*numbers only"),
    "row.ply": (ply("ascii", b"1 2 3\n4 5 6\n7 8 nine\n"), "row 3: .*'nine'"),
    "row.pcd": (pcd("ascii", b"1 2 3 4\n1 2 b 4\n1 2 3 4\n"), "row 2: .*'b'"),
    "comments.xyz": (b"# nothing\n# here\n", "0 points"),
    "binary.xyz": (bytes(range(256)), "numbers|points"),
    "blank.csv": (b"\n\n", "0 points"),
    "heading.csv": (b"x,y,z\n", "0 points"),
    "headings.csv": (b"x,y\n1,2,3\n", "2 column names over 3"),
    "names.csv": (b"a,b,c\n1,2,3\n", "no column 'x'"),
    "twice.csv": (b"x,y,z,x\n1,2,3,4\n", "same name"),
    "gap.csv": (b"x,y,z\n1,,3\n", "could not convert"),
    "decimal.csv": (b"1,5;2,5;3,5\n" * 2, "has decimal commas; expected decimal points"),
    "decimal_heading.csv": (b"x;y;z\n-1,5; 2,5;3,5\n", "decimal commas"),
    "decimal.xyz": (b"1,5 2,5 3,5\n", "decimal commas"),
    "half_a_character.csv": (b"\xff\xfe1\x00,", "not whole UTF-16"),
    "unmarked.csv": ("1,2,3\n".encode("utf-16-le"), "no plain text"),
    "text.npy": (b"1 2 3\n", "does not begin as a .npy"),
    "pickle.npy": (npy(np.array([{}, []], dtype=object)), "plain array of numbers"),
    "complex.npy": (npy(np.ones((2, 3), dtype=complex)), "plain array of numbers"),
    "record.npy": (npy(np.zeros(2, [("x", "f8")])), "plain array of numbers"),
    "flat.npy": (npy(np.ones(3)), "shape \\(3,\\)"),
    "pairs.npy": (npy(np.ones((3, 2))), "shape \\(3, 2\\)"),
    "side.npy": (npy(POINTS.repeat(2, axis=0).T), "shape \\(3, 6\\).*transpose it"),
    "zero.npy": (npy(np.ones((0, 3))), "holds 0"),
    "cut.npy": (npy(POINTS)[:-1], "truncated"),
    "header.npy": (npy(POINTS)[:40], "plain array of numbers"),
    "billion.npy": (npy(POINTS).replace(b"(3, 3), }       ", b"(999999999, 3), "), "plain array|announced"),
    "text.npz": (b"1 2 3\n", "damaged archive"),
    "cut.npz": (npz({"points.npy": npy(POINTS)})[:-30], "damaged archive"),
    "pickle.npz": (npz({"points.npy": npy(np.array([{}], dtype=object))}), "'points.npy': not a plain"),
    "none.npz": (npz({}), "holds nothing"),
    "other.npz": (npz({"a.npy": npy(POINTS), "b.npy": npy(POINTS)}), "holds a, b"),
    "lzma.npz": (npz({"points.npy": npy(POINTS)}, zipfile.ZIP_LZMA), "deflate"),
    "bomb.npz": (npz({"points.npy": npy(np.zeros((10**6, 3)))}), "unpacks to 24000128 bytes"),
    "crc.npz": (npz({"points.npy": npy(POINTS)}, 0).replace(POINTS.tobytes(), (POINTS + 1).tobytes()), "damaged"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_file_gives_one_clear_line(tmp_path, name):
    content, message = BAD_FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CloudError, match=message) as caught:
        read_cloud(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + len(str(tmp_path))
    assert caught.value.__suppress_context__ or caught.value.__context__ is None


@pytest.mark.parametrize("name", [name for name in BAD_FILES if "billion" in name or "skip" in name or "bomb" in name])
def test_lying_header_takes_no_memory(tmp_path, name):
    (tmp_path / name).write_bytes(BAD_FILES[name][0])
    tracemalloc.start()
    try:
        with pytest.raises(CloudError):
            read_cloud(tmp_path / name)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".csv", ".npy", ".npz"])
def test_every_truncation_is_refused(tmp_path, suffix):
    write_cloud(tmp_path / f"a{suffix}", POINTS, **({} if suffix == ".npy" else {"label": [1, 2, 3]}))
    whole = (tmp_path / f"a{suffix}").read_bytes()
    end = whole.rindex(b"\n", 0, -1) + 1 if suffix == ".csv" else len(whole)
    for length in range(end):
        (tmp_path / f"b{suffix}").write_bytes(whole[:length])
        if suffix == ".csv" and length > whole.index(b"\n"):
            continue  # rows are rows: a shorter table of text may be a whole one
        with pytest.raises(CloudError):
            read_cloud(tmp_path / f"b{suffix}")


def test_path_that_is_no_cloud_file(tmp_path):
    (tmp_path / "folder.ply").mkdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.ply")
    else:
        (tmp_path / "pipe.ply").mkdir()
    (tmp_path / "cloud.txt").write_bytes(ROWS)
    for path, message in [
        (tmp_path / "missing.ply", "No such file"),
        (tmp_path / "folder.ply", "directory or device"),
        (tmp_path / "pipe.ply", "directory or device"),
        (tmp_path / "cloud.txt", "unknown suffix '.txt'; expected one of .ply .pcd"),
        (tmp_path / "cloud", "unknown suffix"),
        (tmp_path / "cloud.ply" / "inside.ply", "No such file"),
        ("nul\0.ply", "not a path"),
        (7, "not a path"),
    ]:
        with pytest.raises(CloudError, match=message):
            read_cloud(path)


def test_suffix_in_capitals(tmp_path):
    write_cloud(tmp_path / "A.PLY", POINTS)
    np.testing.assert_array_equal(read_cloud(tmp_path / "A.PLY"), POINTS)


@pytest.mark.parametrize(
    ("name", "points", "columns", "message"),
    [
        ("a.txt", POINTS, {}, "unknown suffix"),
        ("a.ply", POINTS[:, :2], {}, "shape"),
        ("a.ply", POINTS * np.nan, {}, "NaN"),
        ("a.ply", POINTS[:0], {}, "at least 1"),
        ("a.ply", POINTS, {"label": [1, 2]}, "'label'"),
        ("a.ply", POINTS, {"label": np.ones((3, 2))}, "'label'"),
        ("a.ply", POINTS, {"label": [[1], [2, 3], [4]]}, "'label'"),
        ("a.ply", POINTS, {"label": ["a", "b", "c"]}, "'label'"),
        ("a.ply", POINTS, {"label": [2**40, 0, 0]}, "beyond 32 bits"),
        ("a.ply", POINTS, {"two words": [1, 2, 3]}, "'two words'"),
        *(("a.ply", POINTS, {axis: [1, 2, 3]}, f"'{axis}': expected a name") for axis in "xyz"),
        ("a.npz", POINTS, {"label": np.ones((2, 3))}, "'label'"),
        ("a.npz", POINTS, {"label": np.array([{}, {}, {}])}, "'label'"),
        ("a.npy", POINTS, {"label": [1, 2, 3]}, "no names"),
        ("none/a.ply", POINTS, {}, "cannot be written"),
        ("folder.ply", POINTS, {}, "cannot be written"),
    ],
)
def test_bad_writing_leaves_nothing(tmp_path, name, points, columns, message):
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(CloudError, match=message):
        write_cloud(tmp_path / name, points, **columns)
    assert os.listdir(tmp_path) == ["folder.ply"]


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_interrupted_writing_keeps_the_old_file(tmp_path, monkeypatch, failure):
    write_cloud(tmp_path / "a.npz", POINTS)
    old = (tmp_path / "a.npz").read_bytes()

    def half(file, array, **_):
        file.write(b"half")
        raise failure

    monkeypatch.setattr(np.lib.format, "write_array", half)
    with pytest.raises(CloudError if isinstance(failure, OSError) else KeyboardInterrupt):
        write_cloud(tmp_path / "a.npz", POINTS + 1)
    assert os.listdir(tmp_path) == ["a.npz"]
    assert (tmp_path / "a.npz").read_bytes() == old


def test_points_are_not_changed_and_not_shared(tmp_path):
    points = POINTS.copy()
    write_cloud(tmp_path / "a.npy", points)
    np.testing.assert_array_equal(points, POINTS)
    read_cloud(tmp_path / "a.npy")[:] = 0
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy"), POINTS)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ("text", "not an array of numbers"),
        ([[1, 2, "three"]], "not an array of numbers"),
        ([[1, 2], [3]], "not an array of numbers"),
        (np.ones(3), "shape (3,); expected (N, D) with D = 2 or 3"),
        (np.ones((2, 0)), "shape (2, 0); expected (N, D) with D = 2 or 3"),
        (np.ones((2, 4)), "shape (2, 4); expected (N, D) with D = 2 or 3"),
        (np.ones((0, 3)), "0 points; at least 2 needed"),
        (np.ones((1, 3)), "1 points; at least 2 needed"),
        ([[1, 2, 3], [np.nan, 0, np.inf]], "1 of 2 points hold NaN or infinity; drop them first"),
    ],
)
def test_unfit_points(points, message):
    with pytest.raises(CloudError, match="^cloud: " + re.escape(message)):
        check_points(points, "cloud", minimum=2, dimensions=(2, 3))


def test_points_of_any_dimension_but_none():
    assert check_points([[1.0], [2.0]]).shape == (2, 1)
    for points, shape in ((np.ones(3), "(3,)"), (np.ones((2, 0)), "(2, 0)")):
        with pytest.raises(
            CloudError, match="^" + re.escape(f"points: shape {shape}; expected (N, D) with D = 1 or more")
        ):
            check_points(points)


def test_malformed_is_not_seen_outside():
    assert not issubclass(Malformed, CloudError)
    assert not issubclass(CloudError, Malformed)


SOUND = {
    "ply": [
        ply("ascii", ROWS),
        ply("binary_little_endian", POINTS.tobytes(), before="comment made by hand\n"),
        ply("binary_big_endian", POINTS.astype(">f8").tobytes(), after="element face 1\nproperty list uchar int i\n"),
        ply("binary_little_endian", bytes(2) + POINTS.tobytes(), before="element a 1\nproperty short b\n"),
    ],
    "pcd": [
        pcd("ascii", TEXT),
        pcd("binary", RECORDS.tobytes()),
        pcd("binary_compressed", struct.pack("<II", len(PACKED), len(BY_FIELD)) + PACKED),
        pcd("binary_compressed", struct.pack("<II", 65, 4800) + compress(bytes(4800)), n=300),
    ],
    "xyz": [ROWS, b"# x y z label\n" + TEXT],
    "csv": [b"x,y,z\n" + ROWS.replace(b" ", b","), ROWS.replace(b" ", b";")],
    "npy": [npy(POINTS), npy(np.asfortranarray(POINTS, dtype=np.float32))],
    "npz": [npz({"points.npy": npy(POINTS), "label.npy": npy(np.arange(3))}, kind) for kind in (0, 8)],
}
NASTY = b"0|1|2|3|-1|7|255|65536|999999999|2147483648|4294967295|9223372036854775808|1e400|nan|inf|-inf|0x10|1_0||\xb2"
WORDS = sorted({word for files in SOUND.values() for file in files for word in re.findall(rb"[A-Za-z_]{3,}", file)})


def mutant(random: Random) -> tuple[str, bytes]:
    """A suffix and a sound file after one to four blows, most of them where headers and numbers stand."""
    suffix = random.choice(list(SOUND))
    data = random.choice(SOUND[suffix])
    for _ in range(random.choice([1, 1, 1, 2, 3, 4])):
        at = random.randrange(len(data) + 1)
        end = min(len(data), at + random.choice([1, 1, 2, 4, 8, 30]))
        other = random.choice(SOUND[random.choice(list(SOUND))])
        match random.randrange(9):
            case 0:
                data = data[:at] + random.randbytes(end - at) + data[end:]
            case 1:
                data = data[:at] + data[end:]
            case 2:
                data = data[:end] + data[at:]
            case 3:
                data = data[:at]
            case 4:
                data = data[:at] + other[at:]
            case 5:
                numbers = [*re.finditer(rb"-?[0-9.]+", data)]
                if numbers:
                    number = random.choice(numbers)
                    data = data[: number.start()] + random.choice(NASTY.split(b"|")) + data[number.end() :]
            case 6:
                data = data.replace(random.choice(WORDS), random.choice(WORDS), 1)
            case 7:
                lines = data.split(b"\n")
                lines.insert(random.randrange(len(lines)), random.choice(lines))
                data = b"\n".join(lines)
            case 8:
                value = random.choice([0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF])
                data = data[:at] + struct.pack(random.choice(["<I", ">I", "<Q"]), value) + data[at + 4 :]
    return random.choice([suffix] * 9 + list(SOUND)), data


def try_mutants(folder: Path, seed: int, n_cases: int) -> Counter:
    """Read `n_cases` mutants, as if each stood in a file, and count what came of them; excess and surprise fail."""
    random = Random(seed)
    outcomes: Counter = Counter()
    for suffix in SOUND:
        (folder / f"mutant.{suffix}").touch()
    tracemalloc.start()
    try:
        for case in range(n_cases):
            suffix, data = mutant(random)
            path = folder / f"mutant.{suffix}"
            tracemalloc.reset_peak()
            held, began = tracemalloc.get_traced_memory()[0], time.perf_counter()
            try:
                with mock.patch.object(Path, "read_bytes", lambda _, data=data: data):
                    points, refusal = read_cloud(path), None
            except CloudError as error:
                points, refusal = None, str(error)
            except Exception as error:
                raise AssertionError(f"case {case} of seed {seed}: {data!r}") from error
            outcomes["read" if refusal is None else "refused"] += 1
            assert (points is not None and np.isfinite(points).all()) or refusal.startswith(str(path))
            assert refusal is None or "\n" not in refusal
            taken = tracemalloc.get_traced_memory()[1] - held
            assert taken < 2**24 + 100 * len(data), f"case {case} of seed {seed} took {taken} bytes"
            assert time.perf_counter() - began < 10, f"case {case} of seed {seed} hangs"
            outcomes["most memory"] = max(outcomes["most memory"], taken)
    finally:
        tracemalloc.stop()
    return outcomes


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_mutants_are_read_or_refused(tmp_path, seed):
    outcomes = try_mutants(tmp_path, seed, 1500)
    assert outcomes["read"] > 100
    assert outcomes["refused"] > 1000


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 110))
def test_ten_thousand_mutants_are_read_or_refused(tmp_path, seed, record_property, capsys):
    """Ten times: 100,000 hostile files."""
    outcomes = try_mutants(tmp_path, seed, 10_000)
    record_property("cases", 10_000)
    with capsys.disabled():
        print(f"\nhostile files, seed {seed}: 10,000 cases, {dict(outcomes)}")
    assert outcomes["read"] + outcomes["refused"] == 10_000
