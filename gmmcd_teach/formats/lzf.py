"""LZF, the compression inside a binary_compressed .pcd: literal runs, and references to what is already there."""

from __future__ import annotations

from gmmcd_teach.formats import Malformed

RATIO = 88  # three bytes of LZF unpack to 264 at most


def decompress(data: bytes, size: int) -> bytearray:
    """Return the `size` bytes that `data` unpacks to.

    A control byte c below 32 starts a run of c + 1 literal bytes. Otherwise its top three bits are a length (7: the
    next byte adds to it) and the other five, with one more byte, say how far back to copy from; a copy that reaches
    past the end repeats itself.

    Raises
    ------
    Malformed
        The stream ends early, refers to before its start, or does not give `size` bytes.

    Examples
    --------
    >>> bytes(decompress(bytes([0, 97, 0xE0, 1, 0]), 11))
    b'aaaaaaaaaaa'
    """
    out = bytearray()
    position, end = 0, len(data)
    try:
        while position < end:
            control = data[position]
            position += 1
            if control < 32:
                out += data[position : position + control + 1]
                position += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[position]
                position += 1
            length += 2
            back = ((control & 31) << 8 | data[position]) + 1
            position += 1
            start = len(out) - back
            if start < 0:
                raise Malformed("compressed data refer to before their start; the file is damaged")
            if back >= length:
                out += out[start : start + length]
            else:
                out += (out[start:] * (length // back + 1))[:length]
    except IndexError:
        raise Malformed("compressed data end in the middle; the file is truncated") from None
    if len(out) != size or position != end:
        raise Malformed(f"compressed data do not unpack to the {size} bytes announced; the file is damaged")
    return out
