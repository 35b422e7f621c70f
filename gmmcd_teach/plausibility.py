"""Before you trust an answer: do two clouds look like two scans of one place, in metres? (chapter 18)"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from gmmcd_teach.beyond.surface import distinct
from gmmcd_teach.clouds import Floats, check_points

LARGE, SMALL = 500.0, 0.05  # metres; few scans of a place are wider than the one, none is narrower than the other
STRAY = 100  # times as wide as the middle 98 % of its points: no scan is so wide but for stray points
REPEATED = 0.1  # share of points that repeat another, from which on they are told
UNLIKE = 4  # times as many points on one side
N_SAMPLES = 2000


def doubts(before: ArrayLike, after: ArrayLike) -> list[str]:
    """What looks wrong with two clouds (N, 3), (M, 3) that should be scans of one place in metres: one sentence each.

    Asked are stray and repeated points, the size of each cloud and their ratio (another unit), the numbers of points
    (thinned, or a part), the overlap of the boxes around them (another frame), and how far the later points lie from
    the earlier ones (not aligned). No doubt is no proof.

    Raises
    ------
    CloudError
        A cloud is not (N, 3) finite numbers.

    Examples
    --------
    >>> room = np.random.default_rng(0).uniform(0, 4, (5000, 3))
    >>> doubts(room, room + 0.001)
    []
    >>> print(doubts(1000 * room, room)[0])
    before: 3999 x 3999 x 3998 m, larger than any room; in millimetres? (--unit mm)
    """
    clouds = {
        "before": check_points(before, "before", dimensions=(3,)),
        "after": check_points(after, "after", dimensions=(3,)),
    }
    found, sizes = [], {}
    for name, points in clouds.items():
        clouds[name] = distinct(points)
        if (share := 1 - len(clouds[name]) / len(points)) > REPEATED:
            found.append(
                f"{name}: {share:.0%} of the points repeat another; fillers, or saved twice? (keep one of each)"
            )
        sizes[name] = float(np.ptp(points, axis=0).max())
        middle = float(np.ptp(np.quantile(clouds[name], [0.01, 0.99], axis=0), axis=0).max())
        if sizes[name] > STRAY * middle > 0:
            found.append(
                f"{name}: {_extent(points)}, and all but a few points within {middle:.3g} m; stray points? (--outliers)"
            )
            sizes[name] = middle
        elif sizes[name] > LARGE:
            found.append(f"{name}: {_extent(points)}, larger than any room; in millimetres? (--unit mm)")
        elif sizes[name] < SMALL:
            found.append(f"{name}: {_extent(points)}, smaller than a hand; is the file in metres? (--unit)")
    (large, size), (small, other) = sorted(sizes.items(), key=lambda item: -item[1])
    if size > 20 * other:
        return [
            *found,
            f"{large} is {size / other if other else np.inf:.0f} times as wide as {small}: two units? (--unit)",
        ]
    old, new = clouds.values()
    (many, most), (few, least) = sorted(((name, len(s)) for name, s in clouds.items()), key=lambda item: -item[1])
    if most > UNLIKE * least:
        found.append(
            f"{many} has {most / least:.0f} times as many points as {few}: thinned, or only a part of the place?"
        )
    overlap = min(_share_inside(old, new), _share_inside(new, old))
    if overlap < 0.2:
        return [
            *found,
            f"only {overlap:.0%} of one scan lies within the box around the other: two frames? {_boxes(old, new)}",
        ]
    gap, spacing = offset(old, new)
    if gap > max(3 * spacing, 0.01 * size):
        found.append(
            f"half of the later scan lies more than {gap:.3g} m from the earlier one, whose points are {spacing:.2g} m "
            "apart: not aligned? (--align)"
        )
    return found


def offset(fixed: Floats, moving: Floats) -> tuple[float, float]:
    """Median distance of a sample of `moving` (M, 3) to the nearest point of `fixed` (N, 3), and that within `fixed`.

    Examples
    --------
    >>> line = np.linspace(0, 9, 10)[:, None] * [1.0, 0, 0]
    >>> offset(line, line + [0, 0.25, 0])
    (0.25, 1.0)
    """
    tree = cKDTree(fixed, balanced_tree=False, compact_nodes=False)
    gap = np.asarray(tree.query(_sample(moving))[0])
    own = np.asarray(tree.query(_sample(fixed), k=min(2, len(fixed)))[0]).reshape(-1, min(2, len(fixed)))[:, -1]
    return float(np.median(gap)), float(np.median(own))


def _sample(points: Floats) -> Floats:
    return points[:: max(1, len(points) // N_SAMPLES)]


def _share_inside(points: Floats, box: Floats) -> float:
    """Share of the points in the box around the others, which is widened by a twentieth."""
    margin = 0.05 * np.ptp(box, axis=0).max()
    low, high = box.min(axis=0) - margin, box.max(axis=0) + margin
    return float(((points >= low) & (points <= high)).all(axis=1).mean())


def _extent(points: Floats) -> str:
    return " x ".join(f"{length:.3g}" if length < 1000 else f"{length:.0f}" for length in np.ptp(points, axis=0)) + " m"


def _boxes(old: Floats, new: Floats) -> str:
    def span(points: Floats) -> str:
        return ", ".join(
            f"{a} {low:.2f} to {high:.2f}" for a, low, high in zip("xyz", points.min(0), points.max(0), strict=True)
        )

    return f"before {span(old)}; after {span(new)}"
