"""Exercises of chapter 14: distances to tangent planes, weights that leave changes out, one step of alignment."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register

TUKEY, MAD = 4.685, 1.4826


def plane_gaps(points: Floats, feet: Floats, normals: Floats) -> Floats:
    """(N,) signed distances from points to the planes through `feet` with unit `normals`, all (N, 3)."""
    return ((feet - points) * normals).sum(axis=1)


def tukey_weights(gaps: Floats) -> Floats:
    """(N,) weights of Tukey's biweight; the scale is the median size of the gaps."""
    reach = TUKEY * MAD * np.median(np.abs(gaps))
    return np.where(np.abs(gaps) < reach, (1 - (gaps / reach) ** 2) ** 2, 0.0)


def icp_step(points: Floats, normals: Floats, gaps: Floats, weights: Floats) -> Floats:
    """(6,) rotation vector and shift that make the weighted squared distances to the planes least."""
    rows = np.concatenate([np.cross(points, normals), normals], axis=1)  # (N, 6)
    return np.linalg.solve((rows * weights[:, None]).T @ rows, rows.T @ (weights * gaps))


def _planes() -> Iterator[tuple[Floats, Floats, Floats]]:
    for seed in range(3):
        points, feet, normals = np.random.default_rng(seed).normal(size=(3, 8, 3))
        yield points, feet, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _gaps() -> Iterator[tuple[Floats]]:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        yield (np.concatenate([rng.normal(0.002, 0.01, 20), [0.3, -0.4, 0.5]]),)


def _steps() -> Iterator[tuple[Floats, Floats, Floats, Floats]]:
    for seed, (points, _, normals) in enumerate(_planes()):
        rng = np.random.default_rng(seed)
        yield points, normals, rng.normal(0, 0.1, 8), rng.uniform(0.2, 1, 8)


register(
    Exercise(
        "ex-14-1",
        _planes,
        plane_gaps,
        (
            Mistake(
                "that is the distance to the foot point; only the part along the normal counts, so that surfaces may "
                "slide along each other",
                lambda s, q, n: np.linalg.norm(q - s, axis=1),
            ),
            Mistake(
                "the sign is the other way round: it tells how far the point has to go, q - s",
                lambda s, q, n: ((s - q) * n).sum(axis=1),
            ),
            Mistake(
                "keep the sign: it tells on which side the plane lies", lambda s, q, n: np.abs(plane_gaps(s, q, n))
            ),
            Mistake("you multiplied but did not sum: one number for each point", lambda s, q, n: (q - s) * n),
            Mistake(
                "you subtracted nothing: that is the foot point's own height along the normal",
                lambda s, q, n: (q * n).sum(axis=1),
            ),
        ),
    ),
    Exercise(
        "ex-14-2",
        _gaps,
        tukey_weights,
        (
            Mistake(
                "the standard deviation is itself pulled up by what has changed; take the median size",
                lambda g: np.clip(1 - (g / (TUKEY * g.std())) ** 2, 0, None) ** 2,
            ),
            Mistake(
                "beyond the reach (1 - u^2)^2 grows again: far pairs got the largest weights; set them to 0",
                lambda g: (1 - (g / (TUKEY * MAD * np.median(np.abs(g)))) ** 2) ** 2,
            ),
            Mistake(
                "the outer square is missing: (1 - u^2)^2",
                lambda g: np.clip(1 - (g / (TUKEY * MAD * np.median(np.abs(g)))) ** 2, 0, None),
            ),
            Mistake(
                "the median of the gaps is near 0, as they have both signs; take the median of their sizes",
                lambda g: np.clip(1 - (g / (TUKEY * MAD * abs(np.median(g)))) ** 2, 0, None) ** 2,
            ),
            Mistake(
                "that cuts sharply: weight 1 or 0; Tukey's fades to 0",
                lambda g: (np.abs(g) < TUKEY * MAD * np.median(np.abs(g))).astype(float),
            ),
        ),
    ),
    Exercise(
        "ex-14-3",
        _steps,
        icp_step,
        (
            Mistake(
                "the weights are not in it: what has changed pulls, too",
                lambda s, n, g, w: icp_step(s, n, g, 1 + 0 * w),
            ),
            Mistake(
                "the weights count twice: weight the squares, not both factors",
                lambda s, n, g, w: icp_step(s, n, g, w**2),
            ),
            Mistake(
                "the cross product is turned around: s x n, not n x s",
                lambda s, n, g, w: icp_step(s, n, g, w) * [-1, -1, -1, 1, 1, 1],
            ),
            Mistake(
                "the step goes the wrong way: the gaps are what is to be closed",
                lambda s, n, g, w: -icp_step(s, n, g, w),
            ),
            Mistake(
                "the shift stands first in yours; the rotation vector comes first",
                lambda s, n, g, w: np.roll(icp_step(s, n, g, w), 3),
            ),
        ),
        tolerance=1e-6,
    ),
)
