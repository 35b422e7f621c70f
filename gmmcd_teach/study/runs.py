"""The same function on many scenes, seeds and options: in parallel, with progress, and never twice (chapter 10)."""

from __future__ import annotations

import ast
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import metadata
from itertools import product
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
import pooch
from joblib.parallel import get_active_backend

from gmmcd_teach.formats.atomic import write_text_atomically
from gmmcd_teach.progress import progress_bar

PACKAGE = Path(__file__).resolve().parents[1]
LIBRARIES = ("numpy", "scipy", "pot")
Row = dict[str, Any]
Grid = Mapping[str, Iterable[Any]] | Iterable[Mapping[str, Any]]


def run(
    function: Callable[..., Row | list[Row]],
    grid: Grid,
    *,
    n_jobs: int | None = None,
    keep: bool = True,
    progress: bool = True,
) -> pd.DataFrame:
    """Call a function with every combination of arguments and put what it returns into one tidy table.

    Parameters
    ----------
    function : takes the arguments by name, returns one row (a dict of numbers and strings) or a list of rows.
    grid : {argument: values}, of which every combination is run, or a list of {argument: value}.
    n_jobs : processes, as joblib counts them, -1 for one per core; None is what `joblib.parallel_config` says, else 1.
    keep : keep the rows on disk, and take them from there the next time: under a fingerprint of the sources of this
        package that the function can run, its name, its arguments and their data. Only functions of this package are
        kept; the sources of others could change unseen. Where the folder cannot be written to, nothing is kept.
    progress : show a bar.

    Returns
    -------
    One row for each row returned, in the order of the grid, the arguments first. An argument that has a `name` is
    shown by it.

    Examples
    --------
    >>> run(lambda scene, seed: {"score": seed / 2}, {"scene": ["a", "b"], "seed": [0, 1]}).values.tolist()
    [['a', 0, 0.0], ['a', 1, 0.5], ['b', 0, 0.0], ['b', 1, 0.5]]
    """
    jobs = arguments(grid)
    kept = [place(function, job) if keep else None for job in jobs]
    rows = [recall(path) for path in kept]
    missing = [i for i, known in enumerate(rows) if known is None]
    lazy = n_jobs == 1 or get_active_backend()[0].supports_return_generator
    parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator_unordered" if lazy else "list")
    results = parallel(joblib.delayed(_numbered)(i, function, jobs[i]) for i in missing)
    with progress_bar(total=len(jobs), initial=len(jobs) - len(missing), shown=progress, leave=False) as bar:
        for i, found in results:
            rows[i] = found
            remember(kept[i], found)
            bar.update(1)
    shown = [{name: getattr(value, "name", value) for name, value in job.items()} for job in jobs]
    return pd.DataFrame([{**job, **row} for job, found in zip(shown, rows, strict=True) for row in found or []])


def arguments(grid: Grid) -> list[Row]:
    """The calls that a grid stands for, the last argument varying fastest.

    Examples
    --------
    >>> arguments({"a": [1, 2], "b": "x"})
    [{'a': 1, 'b': 'x'}, {'a': 2, 'b': 'x'}]
    """
    if isinstance(grid, Mapping):
        return [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
    return [dict(job) for job in grid]


def _numbered(i: int, function: Callable[..., Any], job: Row) -> tuple[int, list[Row]]:
    found = function(**job)
    rows = [found] if isinstance(found, Mapping) else list(found)
    return i, json.loads(json.dumps(rows, default=_plain))  # the same values whether fresh or kept


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a row holds a {type(value).__name__}; expected numbers, strings, True, False or None")


# ---- what is kept ------------------------------------------------------------------------------------------------


def cache_folder() -> Path:
    """Where results are kept: $GMMCD_TEACH_CACHE, else the user's cache folder."""
    return Path(os.environ.get("GMMCD_TEACH_CACHE") or pooch.os_cache("gmmcd_teach"))


@cache
def fingerprint(part: str = "") -> str:
    """A digest of the numerical libraries and of the sources in a part of this package.

    Parameters
    ----------
    part : a folder; "" for the whole package; or the dotted name of a module, for itself and all that it imports, so
        that a figure or an exercise may change and rows that cannot depend on it stay.

    Examples
    --------
    >>> fingerprint() == fingerprint("lab")
    False
    """
    versions = [f"{name} {metadata.version(name)}" for name in LIBRARIES]
    sources = imported_sources(part) if "." in part else (PACKAGE / part).rglob("*.py")
    contents = ((path.relative_to(PACKAGE).as_posix(), path.read_bytes()) for path in sorted(sources))
    return digest([*versions, *contents])


def imported_sources(module: str) -> set[Path]:
    """Files of this package that a module can run: its own, and those that its import statements name, and theirs.

    Statements inside functions count, too. The `__init__` of a folder counts with its text, but what it gathers from
    the folder's other modules does not, unless the folder itself is imported.

    Examples
    --------
    >>> names = {path.name for path in imported_sources("gmmcd_teach.mdl")}
    >>> "mixture.py" in names, "em.py" in names
    (True, False)
    """
    waiting, found = [module], set[str]()
    while waiting:
        name = waiting.pop()
        if name in found or _file(name) is None:
            continue
        found.add(name)
        waiting += _imports(name)
    parents = {name.rsplit(".", n)[0] for name in found for n in range(1, name.count(".") + 1)}
    return {path for name in found | parents if (path := _file(name)) is not None}


def _file(name: str) -> Path | None:
    path = PACKAGE.joinpath(*name.split(".")[1:])
    files = [path / "__init__.py"] if path.is_dir() else [path.with_suffix(".py")]
    return next((file for file in files if name.split(".")[0] == PACKAGE.name and file.is_file()), None)


def _imports(name: str) -> Iterator[str]:
    """Dotted names after `import` and `from`; of `from a import b` both a and a.b, which may be a module."""
    path = _file(name)
    assert path is not None
    folder = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = folder.split(".")[: folder.count(".") + 2 - node.level] if node.level else []
            source = ".".join([*base, *([node.module] if node.module else [])])
            yield source
            yield from (f"{source}.{alias.name}" for alias in node.names)


def digest(value: Any) -> str:
    """A digest of numbers, strings, arrays, and of lists, dicts and dataclasses of them; equal data, equal digest.

    Raises
    ------
    TypeError
        Something else: it has no data that could be compared.

    Examples
    --------
    >>> digest({"seed": 1}) == digest({"seed": np.int64(1)}), digest([1.0]) == digest([1])
    (True, False)
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str, bytes)):
        parts = [repr(value).encode()]
    elif isinstance(value, np.ndarray):
        parts = [f"{value.dtype.str}{value.shape}".encode(), np.ascontiguousarray(value).tobytes()]
    elif is_dataclass(value) and not isinstance(value, type):
        parts = [digest({field.name: getattr(value, field.name) for field in fields(value)}).encode()]
    elif isinstance(value, Mapping):
        parts = [(digest(name) + digest(value[name])).encode() for name in sorted(value)]
    elif isinstance(value, (list, tuple)):
        parts = [digest(item).encode() for item in value]
    else:
        raise TypeError(f"no digest of a {type(value).__name__}; expected numbers, strings, arrays, or lists of them")
    kind = {list: "list", tuple: "list", np.ndarray: "array"}.get(type(value), type(value).__name__)
    return hashlib.sha256(b"\0".join([kind.encode(), *parts])).hexdigest()[:32]


def place(function: Callable[..., Any], job: Row) -> Path | None:
    """The file for one call's rows; None for a function whose sources are not this package's, also as an argument."""
    module, name = getattr(function, "__module__", ""), getattr(function, "__qualname__", "<")
    if module.split(".")[0] != PACKAGE.name or "<" in name or any(callable(value) for value in job.values()):
        return None
    return cache_folder() / "study" / name / f"{digest([fingerprint(module), module, job])}.json"


def recall(path: Path | None) -> list[Row] | None:
    """Rows that were kept, None where there are none."""
    return json.loads(path.read_text(encoding="utf8")) if path is not None and path.is_file() else None


def remember(path: Path | None, rows: list[Row]) -> None:
    """Keep rows, if there is a place for them that can be written to."""
    if path is not None:
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text_atomically(path, json.dumps(rows))
