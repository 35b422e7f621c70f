"""The command line: `gmmcd-teach detect BEFORE AFTER --out DIR`, or `python -m gmmcd_teach ...` (chapter 18)."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from gmmcd_teach import METHODS, __version__, commands
from gmmcd_teach.clouds import FORMATS
from gmmcd_teach.formats.atomic import check_folder
from gmmcd_teach.lab.scenes import SCENES
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS
from gmmcd_teach.report import FILES

EXIT_CODES = "exit codes: 0 done; 2 bad input, options or output, and one line says what; 130 ended by Ctrl-C"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Examples
    --------
    >>> main(["detect", "nowhere.ply", "nowhere.ply", "--out", "changes"])
    2
    """
    if sys.stderr is None:  # closed by the caller: print would turn to stdout
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    options = parser().parse_args([as_value(word) for word in (sys.argv[1:] if arguments is None else arguments)])
    try:
        check_folder(options.out, options.files)
        words = options.run(options)
    except KeyboardInterrupt:
        return complain("interrupted; nothing was written", 130)
    except MemoryError:
        return complain("not enough memory; thin the scans with a larger --leaf")
    except OSError as error:
        return complain(f"{options.out}: cannot be written ({error.strerror or error})")
    except ValueError as error:  # CloudError is one
        return complain(str(error))
    try:
        print(printable(words), flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is flushed at the end of the process
        if not isinstance(error, BrokenPipeError):  # who closes a pipe has seen enough
            return complain(f"written to {options.out}, but cannot be printed ({error.strerror})")
    return 0


def as_value(word: str) -> str:
    """The word, with a blank before a negative number: argparse takes -1e-3 for an option.

    Examples
    --------
    >>> as_value("-1e-3"), as_value("--leaf")
    (' -1e-3', '--leaf')
    """
    try:
        float(word)
    except ValueError:
        return word
    return f" {word}" if word.startswith("-") else word


def printable(words: str) -> str:
    """The words as the terminal can show them: what it has no sign for is spelt by its number."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return words.encode(encoding, "backslashreplace").decode(encoding)


def complain(words: str, code: int = 2) -> int:
    """One line on stderr; returns the exit code."""
    with suppress(OSError):  # where stderr takes nothing, the code alone tells
        print(f"\rgmmcd-teach: {words}", file=sys.stderr, flush=True)
    return code


def parser() -> argparse.ArgumentParser:
    """The arguments that the command line takes."""
    top = argparse.ArgumentParser(
        prog="gmmcd-teach", description="Learn how a machine notices that a room has changed.", epilog=EXIT_CODES
    )
    top.add_argument("--version", action="version", version=f"gmmcd-teach {__version__}")
    parts = top.add_subparsers(required=True, metavar="COMMAND")
    detect = parts.add_parser(
        "detect",
        help="find what appeared and what disappeared between two scans",
        description="Find what appeared and what disappeared between two scans. Writes to DIR, in metres and in the "
        f"earlier scan's frame, whatever --unit and --align: {', '.join(FILES)}.",
        epilog=EXIT_CODES,
    )
    scans = f"{' '.join(FORMATS)}; a .png is a depth image, with a .json beside it"
    leaves = ", ".join(f"{leaf:g} for {name}" for name, leaf in commands.LEAF.items() if name in METHODS)
    add = detect.add_argument
    add("before", metavar="BEFORE", type=Path, help=f"earlier scan: {scans}")
    add("after", metavar="AFTER", type=Path, help="later scan, in the same coordinate frame (or see --align)")
    add("--out", metavar="DIR", type=Path, required=True, help="folder for the results, made if need be")
    add("--method", choices=tuple(METHODS), default=default_method(), help="how to detect (%(default)s)")
    add("--components", metavar="K", type=int, help=f"components at the start of EM ({commands.COMPONENTS})")
    add("--leaf", metavar="M", type=float, help=f"thin to one point per voxel of M metres ({leaves})")
    add(
        "--unit",
        choices=tuple(commands.UNITS),
        default="m",
        help="unit of the files (%(default)s); depth images know theirs",
    )
    add("--align", action="store_true", help="lay the later scan on the earlier one first")
    add("--outliers", action="store_true", help="take out statistical outliers first")
    for side, scan in (("before", "earlier"), ("after", "later")):
        words = f"where the {scan} scan was taken from, metres; a depth image tells"
        add(f"--{side}-origin", metavar=("X", "Y", "Z"), type=float, nargs=3, help=words)
    add("--seed", metavar="N", type=int, help=f"seed of the random starts ({commands.SEED})")
    add("--json", action="store_true", help="print the report as JSON instead of a table")
    add("--quiet", action="store_true", help="no progress on stderr; warnings stay")
    detect.set_defaults(run=commands.detect, files=FILES)
    pair = parts.add_parser(
        "pair",
        help="write two scans to try things on",
        description="Write a pair of scans, before.ply and after.ply, each with the truth in a column, to DIR.",
        epilog=EXIT_CODES,
    )
    pair.add_argument("name", metavar="NAME", help=f"real: {', '.join(TABLETOP_PAIRS)}; simulated: {', '.join(SCENES)}")
    pair.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder for the scans, made if need be")
    pair.add_argument("--seed", metavar="N", type=int, default=0, help="seed of a simulated pair (%(default)s)")
    pair.set_defaults(run=commands.pair, files=commands.PAIR_FILES)
    return top


def default_method() -> str:
    """The method that the book recommends."""
    return "recommended" if "recommended" in METHODS else "greedy"


if __name__ == "__main__":
    sys.exit(main())
