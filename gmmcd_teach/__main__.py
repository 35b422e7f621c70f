"""The command line: `gmmcd-teach detect BEFORE AFTER --out DIR`, or `python -m gmmcd_teach detect ...`."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from gmmcd_teach import METHODS, CloudError, Detection, detect_changes, read_cloud, write_cloud
from gmmcd_teach.clouds import Floats
from gmmcd_teach.formats.mixtures import write_mixture
from gmmcd_teach.regions import Region, find_regions

EXIT_CODES = "exit codes: 0 done, 2 bad input or options (one line says what), 130 interrupted"
FILES = "appeared.ply, disappeared.ply, before_mixture.npz, after_mixture.npz, report.json, report.html"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Examples
    --------
    >>> main(["detect", "nowhere.ply", "nowhere.ply", "--out", "changes"])
    2
    """
    options = parser().parse_args(arguments)
    try:
        return detect(options)
    except (CloudError, ValueError) as error:
        print(f"gmmcd-teach: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"gmmcd-teach: {options.out}: cannot be written ({error.strerror})", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("gmmcd-teach: interrupted; nothing was written", file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    """The arguments that the command line takes."""
    top = argparse.ArgumentParser(
        prog="gmmcd-teach", description="Learn how a machine notices that a room has changed.", epilog=EXIT_CODES
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    one = commands.add_parser(
        "detect",
        help="find what appeared and what disappeared between two scans",
        description=f"Find what appeared and what disappeared between two scans. Writes to DIR: {FILES}.",
        epilog=EXIT_CODES,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    one.add_argument("before", metavar="BEFORE", type=Path, help="earlier scan: .ply .pcd .xyz .csv .npy .npz, metres")
    one.add_argument("after", metavar="AFTER", type=Path, help="later scan, in the same coordinate frame")
    one.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder for the results, made if need be")
    one.add_argument("--method", choices=tuple(METHODS), default="greedy", help="how to detect")
    one.add_argument("--components", metavar="K", type=int, default=25, help="components at the start of EM")
    one.add_argument("--leaf", metavar="M", type=float, default=None, help="thin to one point per voxel of M metres")
    one.add_argument("--outliers", action="store_true", help="take out statistical outliers first")
    one.add_argument("--before-origin", metavar="M", type=float, nargs=3, help="where the earlier scan was taken from")
    one.add_argument("--after-origin", metavar="M", type=float, nargs=3, help="where the later scan was taken from")
    one.add_argument("--seed", metavar="N", type=int, default=0, help="seed of the random starts")
    one.add_argument("--json", action="store_true", help="print the report as JSON instead of a table")
    one.add_argument("--quiet", action="store_true", help="no progress on stderr")
    return top


def detect(options: argparse.Namespace) -> int:
    """Read, detect, write everything to a folder beside the wanted one, and only then put it in place."""
    before, after = read_cloud(options.before), read_cloud(options.after)
    detection = detect_changes(
        before,
        after,
        method=options.method,
        max_components=options.components,
        leaf_size=options.leaf,
        outlier_filter=options.outliers,
        before_origin=options.before_origin,
        after_origin=options.after_origin,
        rng=options.seed,
        progress=not options.quiet,
    )
    regions = {
        "appeared": find_regions(after[detection.appeared]),
        "disappeared": find_regions(before[detection.disappeared]),
    }
    report = make_report(options, before, after, detection, regions)
    out = options.out
    if out.exists() and not out.is_dir():
        raise CloudError(f"{out}: a file; expected a folder, or a name that is free")
    out.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        write_results(draft, before, after, detection, report)
        out.mkdir(exist_ok=True)
        for file in sorted(draft.iterdir()):
            os.replace(file, out / file.name)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    print(json.dumps(report, indent=2) if options.json else table(report))
    return 0


def make_report(
    options: argparse.Namespace, before: Floats, after: Floats, detection: Detection, regions: dict[str, list[Region]]
) -> dict[str, Any]:
    """What was found, as plain numbers and texts."""
    return {
        "before": {"file": options.before.name, "points": len(before), "disappeared": int(detection.disappeared.sum())},
        "after": {"file": options.after.name, "points": len(after), "appeared": int(detection.appeared.sum())},
        "method": options.method,
        "components": options.components,
        "leaf": options.leaf,
        "seed": options.seed,
        "regions": {kind: [asdict(region) for region in found] for kind, found in regions.items()},
        "seconds": {step: round(spent, 3) for step, spent in detection.seconds.items()},
    }


def write_results(folder: Path, before: Floats, after: Floats, detection: Detection, report: dict[str, Any]) -> None:
    """Write all files of one detection into a folder."""
    from gmmcd_teach.figures import Points, view  # waits for PyVista: only here, so that --help is quick

    for name, points, changed in (
        ("appeared", after, detection.appeared),
        ("disappeared", before, detection.disappeared),
    ):
        if changed.any():
            write_cloud(folder / f"{name}.ply", points[changed])
    for name, mixture in (("before", detection.before_mixture), ("after", detection.after_mixture)):
        if mixture is not None:
            write_mixture(folder / f"{name}_mixture.npz", mixture)
    (folder / "report.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    panels = {
        "before": [Points(before, masks={"disappeared": detection.disappeared})],
        "after": [Points(after, masks={"appeared": detection.appeared})],
    }
    words = f"{report['before']['disappeared']} points disappeared, {report['after']['appeared']} points appeared."
    page = view(panels, alt=f"Two scans side by side. {words}", caption=words, height=620)
    page.save(folder / "report.html", title="What changed", extra=f"<pre>{escape(table(report))}</pre>")


def table(report: dict[str, Any]) -> str:
    """The report in a few lines for a person."""
    lines = [
        f"{report['method']}: {report['after']['appeared']} of {report['after']['points']} points appeared, "
        f"{report['before']['disappeared']} of {report['before']['points']} disappeared "
        f"({report['seconds']['total']:.1f} s)"
    ]
    for kind, found in report["regions"].items():
        for number, region in enumerate(found, start=1):
            x, y, z = region["center"]
            a, b, c = region["size"]
            lines.append(
                f"  {kind:<11} {number:>3}  {region['n_points']:>7} points  at ({x:7.2f}, {y:7.2f}, {z:7.2f}) m"
                f"  size {a:.2f} x {b:.2f} x {c:.2f} m"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
