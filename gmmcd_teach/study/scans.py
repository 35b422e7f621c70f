"""Simulated scans that are made once: a map takes some ten seconds to scan, and a moment to read (chapter 10)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from gmmcd_teach.formats.atomic import write_atomically
from gmmcd_teach.lab import DepthFrame, ScenePair, simulate_pair
from gmmcd_teach.study.runs import cache_folder, fingerprint

FRAMES = ("before_frames", "after_frames")


def scan(scene: str, seed: int = 0, *, progress: bool = False) -> ScenePair:
    """What `simulate_pair(scene, seed)` gives, kept on disk as .npz until the simulator's sources change.

    Where the folder cannot be written to, the pair is simulated each time.

    Raises
    ------
    ValueError
        See `simulate_pair`.

    Examples
    --------
    >>> scan("cargo_bag", 1).object_names
    ('cargo bag',)
    """
    path = cache_folder() / "scans" / f"{scene}-{seed}-{fingerprint('lab')[:12]}.npz"
    if path.is_file():
        return _read(path)
    pair = simulate_pair(scene, seed, progress=progress)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        for old in path.parent.glob(f"{scene}-{seed}-*.npz"):
            old.unlink()
        write_atomically(path, lambda file: np.savez(file, **_arrays(pair)))
    return pair


def backwards(pair: ScenePair) -> ScenePair:
    """The same two scans in the other order of time: what appeared has now disappeared.

    Examples
    --------
    >>> bool(backwards(scan("cargo_bag", 1)).disappeared.any())
    True
    """
    turned = {field.name: field.name for field in fields(pair)}
    for name in turned:
        if "before" in name:
            other = name.replace("before", "after")
            turned[name], turned[other] = other, name
    return replace(pair, **{name: getattr(pair, source) for name, source in turned.items()})


def _arrays(pair: ScenePair) -> dict[str, Any]:
    arrays = {field.name: getattr(pair, field.name) for field in fields(pair) if field.name not in FRAMES}
    for name in FRAMES:
        for part in ("depth", "pose", "intrinsics"):
            arrays[f"{name}.{part}"] = np.array([getattr(frame, part) for frame in getattr(pair, name)])
    return arrays


def _read(path: Path) -> ScenePair:
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    values: dict[str, Any] = {name: value for name, value in arrays.items() if "." not in name}
    values |= {"name": str(values["name"]), "description": str(values["description"])}
    values["object_names"] = tuple(map(str, values["object_names"]))
    for name in FRAMES:
        depths, poses, intrinsics = (arrays[f"{name}.{part}"] for part in ("depth", "pose", "intrinsics"))
        values[name] = tuple(
            DepthFrame(depth, pose, (fx, fy, cx, cy))
            for depth, pose, (fx, fy, cx, cy) in zip(depths, poses, intrinsics.tolist(), strict=True)
        )
    return ScenePair(**values)
