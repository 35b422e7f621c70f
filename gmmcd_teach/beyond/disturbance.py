"""Pairs made harder, one thing at a time, and what a method still answers (chapter 14)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.beyond.alignment import align
from gmmcd_teach.beyond.league import answer, league_pair
from gmmcd_teach.clouds import Floats
from gmmcd_teach.lab import ScenePair
from gmmcd_teach.lab.camera import frame_pixels
from gmmcd_teach.lab.shapes import transform
from gmmcd_teach.lab.survey import rotation
from gmmcd_teach.study.runs import Row


def rigid_motion(shift: float, turn: float, rng: int | np.random.Generator) -> Floats:
    """(4, 4) motion by `shift` metres and `turn` degrees, in random directions.

    Examples
    --------
    >>> round(float(np.linalg.norm(rigid_motion(0.05, 2, 0)[:3, 3])), 3)
    0.05
    """
    along, axis = np.random.default_rng(rng).normal(size=(2, 3))
    motion = np.eye(4)
    motion[:3, :3] = rotation(np.radians(turn) * axis / np.linalg.norm(axis))
    motion[:3, 3] = shift * along / np.linalg.norm(along)
    return motion


def carried(pair: ScenePair, motion: ArrayLike) -> ScenePair:
    """The pair with the later scan, cloud and frames, moved by a rigid motion (4, 4).

    Examples
    --------
    >>> pair = league_pair("cargo_bag", 1)
    >>> bool((carried(pair, np.eye(4)).after == pair.after).all())
    True
    """
    m = np.asarray(motion, dtype=np.float64)
    frames = tuple(replace(frame, pose=m @ frame.pose) for frame in pair.after_frames)
    return replace(pair, after=transform(m, pair.after), after_frames=frames)


def disturbed(
    pair: ScenePair,
    rng: int | np.random.Generator = 0,
    *,
    noise: float = 0.0,
    stride: int = 1,
    lost: float = 0.0,
    shift: float = 0.0,
    turn: float = 0.0,
) -> ScenePair:
    """A pair of single frames, as a worse sensor, a narrower view or a wrong pose would have given it; truth kept.

    Parameters
    ----------
    pair : one depth frame on each side.
    rng : seed or generator.
    noise : metres, standard deviation added to each depth, in both scans.
    stride : keep every so many rows and columns of both images, so one point in stride^2.
    lost : share of the later image's columns, from the right, that are not there.
    shift, turn : metres and degrees by which the later scan's pose is wrong; then cloud and frame move together.

    Raises
    ------
    ValueError
        Not one frame on each side.

    Examples
    --------
    >>> pair = league_pair("cargo_bag", 1)
    >>> bool(len(disturbed(pair, stride=2).after) < len(pair.after) / 3)
    True
    """
    if len(pair.before_frames) != 1 or len(pair.after_frames) != 1:
        raise ValueError(f"pair {pair.name!r} has several frames on a side; expected one, as in 'cargo_bag'")
    rng = np.random.default_rng(rng)
    changed: Row = {}
    for side, share in (("before", 1.0), ("after", 1.0 - lost)):
        (frame,) = getattr(pair, f"{side}_frames")
        points, eye = getattr(pair, side), frame.pose[:3, 3]
        image, z = frame_pixels(frame, points)
        u, v = np.rint(image).astype(np.intp)
        end = round(share * frame.depth.shape[1])
        depth = frame.depth + noise * rng.standard_normal(frame.depth.shape)
        kept = (u % stride == 0) & (v % stride == 0) & (u < end)
        changed[side] = (eye + (points - eye) * (depth[v, u] / z)[:, None])[kept] if noise else points[kept]
        for name in (f"{side}_objects", f"hidden_{side}"):
            changed[name] = getattr(pair, name)[kept]
        depth[:, end:] = np.nan
        intrinsics = tuple(number / stride for number in frame.intrinsics)
        changed[f"{side}_frames"] = (replace(frame, depth=depth[::stride, ::stride], intrinsics=intrinsics),)
    return carried(replace(pair, **changed), rigid_motion(shift, turn, rng))


def robustness_runs(
    method: str,
    scene: str,
    seed: int,
    *,
    aligned: bool | None = None,
    start: int = 0,
    options: Row | None = None,
    **disturbance: Any,
) -> list[Row]:
    """Disturb a pair, align it if asked, and let a method answer.

    Parameters
    ----------
    method, scene, seed : see `league_runs`.
    aligned : True lays the later scan on the earlier one first, False forbids it also to methods that do it by
        themselves, None leaves it to the method.
    start : number of the random start.
    options : what the method is told besides.
    **disturbance : see `disturbed`.

    Examples
    --------
    >>> rows = robustness_runs("occupancy", "cargo_bag", 1, shift=0.05, aligned=True)
    >>> rows[0]["f1"] > 0.8
    True
    """
    pair = disturbed(league_pair(scene, seed), np.random.default_rng([seed, 14]), **disturbance)
    if aligned:
        pair = carried(pair, align(pair.after, pair.before))
    own = {"align": False} if method == "recommended" and aligned is not None else {}
    return answer(method, pair, [seed, start], **own, **(options or {}))
