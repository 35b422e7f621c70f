"""The figures that chapters share. Each draws on `ax` (fresh axes without one) and returns it; axes in metres."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import check_points
from gmmcd_teach.mixture import GaussianMixture, check_mixture

from .style import CYCLE, INK, color_of, distinct_colors

if TYPE_CHECKING:
    from gmmcd_teach.em import Record
    from gmmcd_teach.metrics import Confusion

Floats = NDArray[np.float64]


def plane_matrix(plane: str, n_dimensions: int) -> Floats:
    """Return the (D, 2) matrix from points to the drawing plane: two axes, each with its sign.

    Raises
    ------
    ValueError
        Not two different axes that the points have.

    Examples
    --------
    >>> plane_matrix("x-z", 3).T
    array([[ 1.,  0.,  0.],
           [ 0.,  0., -1.]])
    """
    match = re.fullmatch(r"(-?)([xyz])(-?)([xyz])", plane)
    axes = ["xyz".index(match[2]), "xyz".index(match[4])] if match else [0, 0]
    if match is None or axes[0] == axes[1] or max(axes) >= n_dimensions:
        names = "xyz"[:n_dimensions]
        raise ValueError(
            f"plane {plane!r}: name two of the axes {', '.join(names)}, each with a minus to flip it: 'xy'"
        )
    matrix = np.zeros((n_dimensions, 2))
    matrix[axes, [0, 1]] = [-1.0 if match[1] else 1.0, -1.0 if match[3] else 1.0]
    return matrix


def _metric_axes(ax: Axes | None, plane: str) -> Axes:
    ax = ax or plt.subplots()[1]
    names = re.findall("-?[xyz]", plane)
    ax.set(xlabel=f"{names[0]} [m]", ylabel=f"{names[1]} [m]")
    ax.set_aspect("equal", adjustable="box")
    return ax


def _legend_beside(ax: Axes, markerscale: float = 2.0) -> None:
    """Name each thing once, where the legend covers no data."""
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "facecolor": "none"}
    ax.legend(list(unique.values()), list(unique), markerscale=markerscale, **place)


def split(n: int, meaning: str, masks: Mapping[str, ArrayLike] | None) -> dict[str, NDArray[np.intp]]:
    """Return meaning -> indices of `n` things: each mask (bool (n,) or indices) takes its own, the rest is `meaning`.

    Examples
    --------
    >>> split(4, "unchanged", {"appeared": [True, False, False, True]})
    {'unchanged': array([1, 2]), 'appeared': array([0, 3])}
    """
    groups, left = {}, np.ones(n, dtype=bool)
    for name, mask in (masks or {}).items():
        chosen = np.asarray(mask)
        if chosen.dtype == bool and chosen.shape != (n,):
            raise ValueError(f"mask {name!r}: shape {chosen.shape}; expected ({n},)")
        taken = np.zeros(n, dtype=bool)
        taken[chosen if chosen.size else []] = True
        groups[name] = np.flatnonzero(taken & left)
        left &= ~taken
    return {meaning: np.flatnonzero(left), **groups}


def evenly(n: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` of the indices 0 to n - 1, ascending, spread without a pattern; the same ones every time.

    Examples
    --------
    >>> len(evenly(1000, 10)), len(evenly(3, 10))
    (10, 3)
    """
    return np.arange(n) if n <= most else np.sort(np.random.default_rng(0).permutation(n)[:most])


def fair_shares(sizes: Sequence[int], total: int) -> list[int]:
    """Return how many of each group to draw, `total` in all: small groups whole, the large ones alike.

    Examples
    --------
    >>> fair_shares([1000, 10, 500], 410)
    [200, 10, 200]
    """
    shares, left = [0] * len(sizes), total
    for rank, i in enumerate(sorted(range(len(sizes)), key=lambda i: sizes[i])):
        shares[i] = min(sizes[i], left // (len(sizes) - rank))
        left -= shares[i]
    return shares


def plot_clouds(
    points: ArrayLike,
    *,
    meaning: str = "unchanged",
    masks: Mapping[str, ArrayLike] | None = None,
    groups: ArrayLike | None = None,
    values: ArrayLike | None = None,
    value_label: str = "",
    label: str | None = None,
    plane: str = "xy",
    size: float = 1.0,
    max_points: int = 30_000,
    ax: Axes | None = None,
) -> Axes:
    """Draw points (N, D) seen along an axis, coloured by what they mean; call again on `ax` to lay one over another.

    Parameters
    ----------
    points : (N, D) metres, D = 2 or 3.
    meaning : a key of COLORS or a hex colour, for the points that no mask takes.
    masks : meaning -> (N,) bool or indices; drawn on top, in their order.
    groups : (N,) int instead: one colour per group, as for `mixture.assign(points)`.
    values : (N,) float instead: a colour scale, named by `value_label`.
    label : legend text in place of the name of the meaning.
    plane : axes to the right and up, "xy" from above; "x-y" flips y, as for a camera's frame.
    size : area of a point, square points (1/72 inch).
    max_points : the groups share this many points, small groups first; the others are left out evenly.
    """
    points = check_points(points, minimum=0, dimensions=(2, 3))
    flat = points @ plane_matrix(plane, points.shape[1])  # (N, 2)
    ax = _metric_axes(ax, plane)
    style: dict[str, Any] = {"s": size, "linewidths": 0, "antialiased": False}
    if values is not None or groups is not None:
        few = evenly(len(points), max_points)
    if values is not None:
        drawn = ax.scatter(flat[few, 0], flat[few, 1], c=np.asarray(values)[few], **style)
        ax.figure.colorbar(drawn, ax=ax, label=value_label, shrink=0.8)
    elif groups is not None:
        colors = np.array(CYCLE)[np.asarray(groups)[few] % len(CYCLE)]
        ax.scatter(flat[few, 0], flat[few, 1], c=list(colors), **style)
    else:
        parts = split(len(points), meaning, masks)
        shares = fair_shares([len(chosen) for chosen in parts.values()], max_points)
        for (name, everyone), share in zip(parts.items(), shares, strict=True):
            shown = (label or name) if name == meaning else name
            chosen = everyone[evenly(len(everyone), share)]
            if len(chosen):
                ax.scatter(flat[chosen, 0], flat[chosen, 1], color=color_of(name), label=shown, **style)
        _legend_beside(ax, markerscale=max(1.0, 5 / size**0.5))
    return ax


def plot_mixture(
    mixture: GaussianMixture,
    *,
    meaning: str = "after",
    masks: Mapping[str, ArrayLike] | None = None,
    groups: bool = False,
    label: str | None = None,
    plane: str = "xy",
    n_std: float = 2.0,
    numbers: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw each component as the ellipse at `n_std` standard deviations, truly oriented; the heavier, the fuller.

    A 3-D component shows its shadow on the plane: the ellipse of the two coordinates' own covariance.

    Parameters
    ----------
    mixture : weights (K,), means (K, D), covariances (K, D, D), metres.
    meaning, masks : as for `plot_clouds`, for components: {"appeared": detection.appeared_components}.
    groups : one colour per component, the same as plot_clouds(groups=mixture.assign(points)).
    numbers : write each component's index at its mean.
    """
    matrix = plane_matrix(plane, check_mixture(mixture, "mixture").n_dimensions)
    ax = _metric_axes(ax, plane)
    means = mixture.means @ matrix  # (K, 2)
    widths, heights, angles = ellipse_axes(matrix.T @ mixture.covariances @ matrix, n_std)
    parts = split(len(means), meaning, masks)
    colors = distinct_colors(len(means)) if groups else [""] * len(means)
    for name, chosen in parts.items():
        for k in chosen:
            color = colors[k] or color_of(name)
            alpha = 0.12 + 0.45 * float(mixture.weights[k] / mixture.weights.max())
            for face, edge, opacity in ((color, "none", alpha), ("none", color, 1.0)):
                look: dict[str, Any] = {"facecolor": face, "edgecolor": edge, "alpha": opacity, "linewidth": 1.4}
                ax.add_patch(Ellipse((means[k, 0], means[k, 1]), widths[k], heights[k], angle=angles[k], **look))
        if len(chosen) and not groups:
            shown = (label or name) if name == meaning else name
            ax.scatter(means[chosen, 0], means[chosen, 1], color=color_of(name), s=9, label=shown)
    for k, mean in enumerate(means if numbers else []):
        ax.annotate(str(k), mean, ha="center", va="center", fontsize=9, fontweight="bold")
    ax.autoscale_view()
    return ax


def ellipse_axes(covariances: ArrayLike, n_std: float = 2.0) -> tuple[Floats, Floats, Floats]:
    """Return full widths and heights (K,) in metres and angles (K,) in degrees of the ellipses of (K, 2, 2).

    Examples
    --------
    >>> ellipse_axes([[[4.0, 0.0], [0.0, 1.0]]])[:2]
    (array([8.]), array([4.]))
    """
    variances, axes = np.linalg.eigh(np.asarray(covariances, dtype=np.float64))
    extents = 2 * n_std * np.sqrt(np.maximum(variances, 0))  # (K, 2), ascending
    angles = np.degrees(np.arctan2(axes[:, 1, 1], axes[:, 0, 1]))
    return extents[:, 1], extents[:, 0], angles


def plot_history(history: Sequence[Record], *, over: str = "n_components", ax: Axes | None = None) -> Axes:
    """Draw the path of `fit_mixture`: description length and log-likelihood (nats) as components are taken away.

    Parameters
    ----------
    history : MixtureFit.history; its last steps, the polish on all points, are left out.
    over : "n_components" for the value reached at each K; "iteration" for every record, with a mark where components
        died or were removed. The star is the least description length.

    Raises
    ------
    ValueError
        Another `over`, or no records.
    """
    events = np.array([record.event for record in history])
    path = history[: int(np.argmax(events == "polish")) if "polish" in events else len(events)]
    if over not in ("n_components", "iteration") or not path:
        raise ValueError(f"over {over!r}: 'n_components' or 'iteration'; and at least one record, not {len(path)}")
    counts, lengths, likelihoods = np.array(
        [(record.n_components, record.description_length, record.log_likelihood) for record in path]
    ).T
    ax = ax or plt.subplots()[1]
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ends = np.flatnonzero(np.append(counts[1:] != counts[:-1], True))  # the last record at each K
    shown, x, marker = np.arange(len(path)), np.arange(len(path)), ""
    if over == "n_components":
        shown, x, marker = ends, counts, "."
        ax.invert_xaxis()
    ax.plot(x[shown], lengths[shown], color=CYCLE[0], marker=marker, label="description length")
    ax.plot(x[shown], -likelihoods[shown], color=CYCLE[1], ls="--", label="minus log-likelihood")
    if over == "iteration":
        for event, mark in (("annihilated", "v"), ("removed", "|")):
            chosen = np.flatnonzero(events[: len(path)] == event)
            if len(chosen):
                ax.plot(chosen, lengths[chosen], mark, ms=7, color=INK, label=event)
    best = shown[np.argmin(lengths[shown])]
    low, high = -likelihoods[best], lengths[ends].max()  # what a removal throws up for a moment may leave the picture
    ax.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    ax.plot(x[best], lengths[best], "*", ms=14, color=CYCLE[2], label=f"least: K = {counts[best]:.0f}")
    ax.set(xlabel="components K" if over == "n_components" else "M-steps and starts", ylabel="nats")
    ax.legend()
    return ax


def plot_flow(
    before: GaussianMixture,
    after: GaussianMixture,
    flow: ArrayLike,
    *,
    plane: str = "xy",
    ax: Axes | None = None,
    widest: float = 8.0,
) -> Axes:
    """Draw the mass that flows between two mixtures: one line per pair of components, as wide as its flow (K, L).

    Parameters
    ----------
    before, after : mixtures of K and L components, drawn beneath.
    flow : (K, L) mass, as `emd(...).flow`.
    widest : width of the largest flow, in points.
    """
    flow = np.asarray(flow, dtype=np.float64)
    if flow.shape != (len(before.means), len(after.means)):
        raise ValueError(f"flow: shape {flow.shape}; expected ({len(before.means)}, {len(after.means)})")
    ax = plot_mixture(before, meaning="before", plane=plane, ax=ax)
    plot_mixture(after, meaning="after", plane=plane, ax=ax)
    rows, columns = np.nonzero(flow > 1e-9 * flow.max(initial=0))
    matrix = plane_matrix(plane, before.means.shape[1])
    segments = np.stack([before.means[rows] @ matrix, after.means[columns] @ matrix], axis=1)  # (lines, 2, 2)
    widths = widest * flow[rows, columns] / flow.max(initial=1e-300)
    lines = LineCollection(list(segments), linewidths=widths, colors=INK, alpha=0.6, capstyle="round", zorder=3)
    ax.add_collection(lines)
    _legend_beside(ax)
    return ax


def plot_extraction(
    distances: ArrayLike, *, names: Sequence[str] | None = None, tried: ArrayLike | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the EMD as components are taken: `distances` (T + 1,) in metres, before the first removal and after each.

    Parameters
    ----------
    names : T names of what was taken, written at each fall; Extraction.indices will do.
    tried : (tries, 2) optional steps and the EMD that the rejected removals of that step would have given.
    """
    values = np.asarray(distances, dtype=np.float64)
    ax = ax or plt.subplots()[1]
    if tried is not None:
        steps, others = np.asarray(tried, dtype=np.float64).T
        ax.scatter(steps, others, color=color_of("unchanged"), s=10, label="tried, not taken")
        ax.legend()
    ax.plot(values, color=color_of("appeared"), marker="o", ms=5)
    for step, name in enumerate(names if names is not None else [], start=1):
        ax.annotate(str(name), (step, values[step]), xytext=(4, 6), textcoords="offset points", fontsize=9)
    ax.set(xlabel="components taken", ylabel="EMD [m]", xticks=np.arange(len(values)))
    ax.set_ylim(bottom=0)
    return ax


def plot_confusion(confusion: Confusion, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Draw the four counts of a Confusion (tp, fp, fn, tn) as a table, prediction in rows, truth in columns."""
    counts = np.array([[confusion.tp, confusion.fp], [confusion.fn, confusion.tn]])
    ax = ax or plt.subplots(figsize=(3.2, 2.6))[1]
    right = np.array([[1, 0], [0, 1]])
    for (row, column), count in np.ndenumerate(counts):
        color = color_of("unchanged") if right[row, column] else color_of("appeared")
        ax.add_patch(plt.Rectangle((column, row), 1, 1, facecolor=color, alpha=0.3, edgecolor="white", lw=3))
        word = [["true +", "false +"], ["false -", "true -"]][row][column]
        ax.text(column + 0.5, row + 0.5, f"{count:,}\n{word}", ha="center", va="center")
    ax.set(
        xlim=(0, 2), ylim=(2, 0), xticks=[0.5, 1.5], yticks=[0.5, 1.5], title=title, xlabel="truth", ylabel="predicted"
    )
    ax.set_xticklabels(["changed", "not"])
    ax.set_yticklabels(["changed", "not"])
    ax.grid(False)
    return ax


def plot_scores(
    scores: Mapping[str, Mapping[str, ArrayLike]],
    *,
    published: Mapping[str, float] | None = None,
    ylabel: str = "score",
    ax: Axes | None = None,
) -> Axes:
    """Draw means over seeds as bars with the middle 95 % of the seeds as a line.

    Parameters
    ----------
    scores : series -> {category: (seeds,) values}: {"greedy": {"F1": [...], "recall": [...]}, "shared": {...}}.
    published : category -> the paper's value, drawn as a dotted line across the bars.
    """
    ax = ax or plt.subplots()[1]
    categories = list(dict.fromkeys(name for series in scores.values() for name in series))
    width = 0.8 / max(len(scores), 1)
    for i, ((series, columns), color) in enumerate(zip(scores.items(), distinct_colors(len(scores)), strict=True)):
        x = np.array([categories.index(name) for name in columns]) - 0.4 + width * (i + 0.5)
        samples = [np.asarray(values, dtype=np.float64).ravel() for values in columns.values()]
        means = np.array([sample.mean() for sample in samples])
        low, high = np.array([np.quantile(sample, [0.025, 0.975]) for sample in samples]).T
        ends = np.maximum([means - low, high - means], 0)
        ax.bar(x, means, 0.9 * width, color=color, label=series, yerr=ends, ecolor=INK, capsize=3)
    for name, value in (published or {}).items():
        middle = categories.index(name)
        ax.hlines(value, middle - 0.45, middle + 0.45, color=INK, lw=2, ls=":", label="the paper")
    _legend_beside(ax)
    ax.set(ylabel=ylabel, xticks=range(len(categories)))
    ax.set_xticklabels(categories)
    ax.grid(axis="x", visible=False)
    return ax
