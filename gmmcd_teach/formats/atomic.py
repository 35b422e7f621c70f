"""Files that appear complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a new file beside `path`, then put it in the place of `path`; on any failure leave nothing.

    Raises
    ------
    OSError
        The folder is missing, full or not writable, or `path` is a folder.
    """
    draft = path.with_name(f".{path.name}.{uuid4().hex}")
    try:
        with open(draft, "xb") as file:
            write(file)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)
