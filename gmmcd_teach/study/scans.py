"""Simulated scans that are made once: a map takes some ten seconds to scan, and a moment to read (chapter 10)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gmmcd_teach.formats.atomic import write_atomically
from gmmcd_teach.lab import DepthFrame, ScenePair, simulate_pair
from gmmcd_teach.study.runs import Row, cache_folder, fingerprint

FRAMES = ("before_frames", "after_frames")
FRAME_PARTS = ("depth", "pose", "intrinsics")


def scan(scene: str, seed: int = 0, *, frames: bool = True, progress: bool = False) -> ScenePair:
    """What `simulate_pair(scene, seed)` gives, kept on disk as .npz until the simulator's sources change.

    Where the folder cannot be written to, the pair is simulated each time.

    Parameters
    ----------
    scene, seed, progress : see `simulate_pair`.
    frames : False leaves the depth frames out, and does not keep them: those of a map take 35 MB.

    Raises
    ------
    ValueError
        See `simulate_pair`.

    Examples
    --------
    >>> scan("cargo_bag", 1).object_names
    ('cargo bag',)
    """
    folder, version = cache_folder() / "scans", fingerprint("lab")[:12]
    paths = [folder / f"{scene}-{seed}-{version}{part}.npz" for part in ("", "-frames")]
    wanted = paths if frames else paths[:1]
    if all(path.is_file() for path in wanted):
        return _read(wanted)
    pair = simulate_pair(scene, seed, progress=progress)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        for old in set(folder.glob(f"{scene}-{seed}-*.npz")) - set(paths):
            old.unlink()
        for path, arrays in zip(wanted, (_clouds(pair), _frames(pair)), strict=False):
            write_atomically(path, partial(np.savez, **arrays))
    return pair if frames else replace(pair, before_frames=(), after_frames=())


def cloud_sizes(scene: str, seed: int) -> Row:
    """How many points both clouds of a pair hold; the pair is kept, without its frames, for the runs to come.

    Examples
    --------
    >>> sorted(cloud_sizes("cargo_bag", 1))
    ['after', 'before']
    """
    pair = scan(scene, seed, frames=False)
    return {"before": len(pair.before), "after": len(pair.after)}


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


def _clouds(pair: ScenePair) -> dict[str, Any]:
    return {field.name: getattr(pair, field.name) for field in fields(pair) if field.name not in FRAMES}


def _frames(pair: ScenePair) -> dict[str, Any]:
    return {
        f"{name}.{part}": np.array([getattr(frame, part) for frame in getattr(pair, name)])
        for name in FRAMES
        for part in FRAME_PARTS
    }


def _read(paths: Sequence[Path]) -> ScenePair:
    arrays: dict[str, Any] = {}
    for path in paths:
        with np.load(path, allow_pickle=False) as file:
            arrays |= {name: file[name] for name in file.files}
    values: dict[str, Any] = {name: value for name, value in arrays.items() if "." not in name}
    values |= {"name": str(values["name"]), "description": str(values["description"])}
    values["object_names"] = tuple(map(str, values["object_names"]))
    for name in FRAMES:
        depths, poses, intrinsics = (arrays.get(f"{name}.{part}", np.empty(0)) for part in FRAME_PARTS)
        values[name] = tuple(
            DepthFrame(depth, pose, (fx, fy, cx, cy))
            for depth, pose, (fx, fy, cx, cy) in zip(depths, poses, intrinsics.tolist(), strict=True)
        )
    return ScenePair(**values)
