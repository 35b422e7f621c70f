"""Files and folders of results that appear complete or not at all."""

from __future__ import annotations

import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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


def write_text_atomically(path: Path, text: str) -> None:
    """Write a text file in UTF-8, all or nothing; fails as `write_atomically` does.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as home:
    ...     write_text_atomically(Path(home, "a.txt"), "a")
    ...     os.listdir(home)
    ['a.txt']
    """
    write_atomically(path, lambda file: file.write(text.encode()))


def check_folder(folder: Path, files: Sequence[str] = ()) -> None:
    """Refuse a folder for results that cannot be made or written to, before any work is done for it.

    Raises
    ------
    OSError
        It is a file, lies below one, or the user may not write there; or one of `files` is a folder in it.
    """
    if folder.exists() and not folder.is_dir():
        raise OSError(0, "a file; expected a folder, or a name that is free", str(folder))
    home = _home(folder)
    if not home.is_dir():
        raise OSError(0, f"{home.name} is a file; expected a folder", str(folder))
    if not os.access(home, os.W_OK | os.X_OK):
        raise OSError(0, f"no permission to write in {home}", str(folder))
    if taken := [name for name in files if (folder / name).is_dir()]:
        raise OSError(0, f"{taken[0]} in it is a folder; expected a file, or nothing", str(folder))


@contextmanager
def place_folder(folder: Path, files: Sequence[str]) -> Iterator[Path]:
    """Yield an empty folder to be filled with some of `files`; at the end all of them move to `folder` at once.

    On any failure, Ctrl-C included, `folder` is as it was. What it held besides `files` stays.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as home:
    ...     with place_folder(Path(home, "results"), ["a.txt"]) as draft:
    ...         _ = (draft / "a.txt").write_text("a")
    ...     os.listdir(home), os.listdir(f"{home}/results")
    (['results'], ['a.txt'])

    Raises
    ------
    OSError
        The disk is full, or the folder cannot be made.
    """
    check_folder(folder, files)
    draft = _home(folder) / f".{folder.name}.{uuid4().hex}"
    try:
        draft.mkdir()
        yield draft
        check_folder(folder, files)
        with _undisturbed():
            if not folder.exists():
                folder.parent.mkdir(parents=True, exist_ok=True)
                os.rename(draft, folder)
                return
            for name in files:
                if (draft / name).exists():
                    os.replace(draft / name, folder / name)
                else:
                    (folder / name).unlink(missing_ok=True)
    except ValueError as error:  # a writer's own sentence names the draft, which is of no use to anyone
        if isinstance(error.__context__, OSError):
            raise error.__context__ from None
        raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _home(folder: Path) -> Path:
    """The folder itself where it exists, else the nearest thing above it that does: of the same disk."""
    return next(place for place in (folder, *folder.absolute().parents) if place.exists())


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Let a Ctrl-C wait for the few renames that must not be cut in two."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
