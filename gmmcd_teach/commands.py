"""What the commands of the command line do, step by step (chapter 18)."""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gmmcd_teach.clouds import CloudError, Floats, read_cloud, write_cloud
from gmmcd_teach.detection import Detection
from gmmcd_teach.formats.atomic import place_folder
from gmmcd_teach.formats.depth import read_depth
from gmmcd_teach.lab import simulate_pair, tabletop_pair
from gmmcd_teach.lab.scenes import SCENES
from gmmcd_teach.lab.shapes import transform
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS
from gmmcd_teach.methods import METHODS, detect_changes, options_of
from gmmcd_teach.plausibility import doubts, offset
from gmmcd_teach.regions import contradicted_by, find_regions
from gmmcd_teach.report import FILES, NEAR, SEEN, as_numbers, good_camera, table, write_results

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
LEAF = {"greedy": 0.02, "shared": 0.02}  # metres; other methods choose by the density of the scans
COMPONENTS = 25  # at the start of EM
SEED = 0
REMEDIES = {  # words in a message of the methods: what helps on the command line
    "covariance_floor": "here: --outliers takes out stray points, --leaf thins, --components asks for fewer",
    "points; at least": "here: fewer --components, or a finer --leaf",
}
PAIR_FILES = ("before.ply", "after.ply")


def detect(options: argparse.Namespace) -> str:
    """Read, check, align, detect, write; returns what to print."""

    def say(text: str) -> None:
        if not options.quiet:
            print(text, file=sys.stderr, flush=True)

    keep_inputs(options.out, (options.before, options.after))
    say(f"reading {options.before.name} and {options.after.name}")
    before, after = (in_metres(path, options.unit) for path in (options.before, options.after))
    before_origin = origin_of(options.before, options.before_origin)
    after_origin = origin_of(options.after, options.after_origin)
    motion = np.eye(4)
    warnings: list[str] = []
    if options.align:
        say("aligning")
        motion, warnings = aligned(before, after)
        after = transform(motion, after)
        after_origin = None if after_origin is None else transform(motion, after_origin)
    warnings += doubts(before, after)
    takes = options_of(METHODS[options.method])
    warnings += [
        f"{options.method} {does_not}: {option} is not used"
        for option, told, name, does_not in (
            (f"--leaf {options.leaf}", options.leaf is not None, "leaf_size", "does not thin the scans"),
            ("--components", options.components is not None, "max_components", "fits no mixture"),
            ("--outliers", options.outliers, "outlier_filter", "does not filter the scans"),
            ("--seed", options.seed is not None, "rng", "draws no random numbers"),
        )
        if told and name not in takes
    ]
    for warning in warnings:
        print(f"gmmcd-teach: warning: {warning}", file=sys.stderr, flush=True)
    untold = [f"--{side}-origin" for side, at in (("before", before_origin), ("after", after_origin)) if at is None]
    if "before_origin" in takes and untold:
        say(f"{options.method} does better when told where each scan was taken from: {', '.join(untold)}")
    say(f"detecting by {options.method}")
    leaf = LEAF.get(options.method) if options.leaf is None else options.leaf
    components = COMPONENTS if options.components is None else options.components
    seed = SEED if options.seed is None else options.seed
    try:
        detection = detect_changes(
            before,
            after,
            method=options.method,
            max_components=components,
            leaf_size=leaf,
            outlier_filter=options.outliers,
            before_origin=before_origin,
            after_origin=after_origin,
            rng=seed,
            progress=not options.quiet,
        )
    except CloudError as error:
        remedy = next((f" ({words})" for cause, words in REMEDIES.items() if cause in str(error)), "")
        raise CloudError(f"{error}{remedy}") from None
    settings = {"components": ("max_components", components), "leaf": ("leaf_size", leaf), "seed": ("rng", seed)}
    report = {
        "before": {"file": options.before.name, "points": len(before), "disappeared": int(detection.disappeared.sum())},
        "after": {"file": options.after.name, "points": len(after), "appeared": int(detection.appeared.sum())},
        "method": options.method,
        **{name: chosen for name, (option, chosen) in settings.items() if option in takes},
        "warnings": warnings,
        "alignment": motion.tolist(),
        **found(before, after, before_origin, after_origin, detection),
        "seconds": {step: round(spent, 3) for step, spent in detection.seconds.items()},
    }
    say(f"writing {options.out}")
    with place_folder(options.out, FILES) as draft:
        camera = good_camera(np.concatenate([before, after]), before_origin)
        write_results(draft, before, after, detection, report, camera)
    return json.dumps(report, indent=2) if options.json else table(report)


def keep_inputs(folder: Path, scans: tuple[Path, Path]) -> None:
    """Refuse a folder for results in which a result would take the place of a scan that is to be read."""
    for scan in scans:
        if taken := [name for name in FILES if (folder / name).resolve() == scan.resolve()]:
            raise ValueError(f"{scan}: {taken[0]} is one of the results in {folder}; expected another folder for --out")


def in_metres(path: Path, unit: str) -> Floats:
    """The points (N, 3) of a file in this unit; a depth image is in metres always, by its .json."""
    return read_cloud(path) * (1.0 if path.suffix.lower() == ".png" else UNITS[unit])


def found(
    before: Floats, after: Floats, before_origin: Floats | None, after_origin: Floats | None, detection: Detection
) -> dict[str, Any]:
    """The groups of changed points in each direction, and what their confidence means."""
    gone, new = detection.disappeared, detection.appeared
    old_votes = contradicted_by(before, after, origin=after_origin)
    new_votes = contradicted_by(after, before, origin=before_origin)
    return {
        "regions": {
            "appeared": as_numbers(find_regions(after[new], contradicted=new_votes[new])),
            "disappeared": as_numbers(find_regions(before[gone], contradicted=old_votes[gone])),
        },
        "confidence": {
            "appeared": NEAR if before_origin is None else SEEN,
            "disappeared": NEAR if after_origin is None else SEEN,
        },
    }


def aligned(before: Floats, after: Floats) -> tuple[Floats, list[str]]:
    """The motion (4, 4) that lays the later scan on the earlier one, and a warning where it is an unlikely one."""
    from gmmcd_teach.beyond.alignment import align

    gap, _ = offset(before, after)
    motion = align(after, before, max_distance=max(0.1, 3 * gap))
    middle = after.mean(axis=0)
    shift = float(np.linalg.norm(transform(motion, middle) - middle))
    turn = float(np.degrees(Rotation.from_matrix(motion[:3, :3]).magnitude()))
    if shift > 0.1 * np.ptp(before, axis=0).max() or turn > 10:
        return motion, [
            f"the alignment moved the later scan by {shift:.2f} m and {turn:.1f} degrees; look whether it fits"
        ]
    return motion, []


def origin_of(path: Path, told: list[float] | None) -> Floats | None:
    """Where a scan was taken from, (3,) metres: as told, or as the pose of a depth image has it."""
    if told is not None:
        return np.array(told)
    return read_depth(path).pose[:3, 3] if path.suffix.lower() == ".png" else None


def pair(options: argparse.Namespace) -> str:
    """Write two scans with the truth, before.ply and after.ply; returns how to go on."""
    if options.name not in (*TABLETOP_PAIRS, *SCENES):
        raise ValueError(f"pair {options.name!r}; expected one of {', '.join((*TABLETOP_PAIRS, *SCENES))}")
    if taken := [name for name in PAIR_FILES if (options.out / name).exists()]:
        raise ValueError(f"{options.out}: holds {taken[0]} already, which stays as it is; expected another folder")
    real = options.name in TABLETOP_PAIRS
    scans = tabletop_pair(options.name) if real else simulate_pair(options.name, options.seed)
    with place_folder(options.out, PAIR_FILES) as draft:
        write_cloud(draft / PAIR_FILES[0], scans.before, disappeared=scans.disappeared)
        write_cloud(draft / PAIR_FILES[1], scans.after, appeared=scans.appeared)
    words = [*called(), "detect", *(str(options.out / name) for name in PAIR_FILES)]
    words += ["--out", str(options.out / "changes")]
    for side, frames in (("before", scans.before_frames), ("after", scans.after_frames)):
        if len(frames) == 1:
            words += [f"--{side}-origin", *(f"{x:.4f}" for x in frames[0].pose[:3, 3])]
    return f"{scans.description}\nNow try: {shlex.join(words)}"


def called() -> list[str]:
    """The words that call this command line again, as it was called."""
    if Path(sys.argv[0]).stem == "gmmcd-teach":
        return ["gmmcd-teach" if shutil.which("gmmcd-teach") else sys.argv[0]]
    python, here = Path(sys.executable), Path.cwd()
    return [str(python.relative_to(here) if python.is_relative_to(here) else python), "-m", "gmmcd_teach"]
