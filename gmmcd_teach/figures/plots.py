"""The figures that chapters share. Each draws on `ax` (fresh axes without one) and returns it; axes in metres."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from numpy.typing import ArrayLike, NDArray

from .style import CYCLE, INK, color_of, distinct_colors

if TYPE_CHECKING:
    from gmmcd_teach.mixture import GaussianMixture

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
    ax.set_aspect("equal", adjustable="datalim")
    return ax


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
    """
    points = np.asarray(points, dtype=np.float64)
    ax = _metric_axes(ax, plane)
    flat = points @ plane_matrix(plane, points.shape[1])  # (N, 2)
    style: dict[str, Any] = {"s": size, "linewidths": 0, "rasterized": True}
    if values is not None:
        drawn = ax.scatter(flat[:, 0], flat[:, 1], c=np.asarray(values), **style)
        ax.figure.colorbar(drawn, ax=ax, label=value_label, shrink=0.8)
    elif groups is not None:
        numbers = np.asarray(groups)
        ax.scatter(flat[:, 0], flat[:, 1], c=np.array(CYCLE)[numbers % len(CYCLE)], **style)
    else:
        for name, chosen in split(len(points), meaning, masks).items():
            shown = (label or name) if name == meaning else name
            if len(chosen):
                ax.scatter(flat[chosen, 0], flat[chosen, 1], color=color_of(name), label=shown, **style)
        ax.legend(markerscale=max(1.0, 4 / size**0.5), loc="best")
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
    ax = _metric_axes(ax, plane)
    matrix = plane_matrix(plane, mixture.means.shape[1])
    means = mixture.means @ matrix  # (K, 2)
    widths, heights, angles = ellipse_axes(matrix.T @ mixture.covariances @ matrix, n_std)
    parts = split(len(means), meaning, masks)
    colors = distinct_colors(len(means)) if groups else [""] * len(means)
    for name, chosen in parts.items():
        for k in chosen:
            color = colors[k] or color_of(name)
            alpha = 0.12 + 0.45 * float(mixture.weights[k] / mixture.weights.max())
            shape = {"units": "xy", "offsets": means[k], "offset_transform": ax.transData}
            sizes = (widths[k], heights[k], angles[k])
            ax.add_collection(EllipseCollection(*sizes, facecolor=color, alpha=alpha, **shape))
            ax.add_collection(EllipseCollection(*sizes, facecolor="none", edgecolor=color, linewidth=1.4, **shape))
        if len(chosen) and not groups:
            shown = (label or name) if name == meaning else name
            ax.scatter(means[chosen, 0], means[chosen, 1], color=color_of(name), s=9, label=shown)
    for k, mean in enumerate(means if numbers else []):
        ax.annotate(str(k), mean, ha="center", va="center", fontsize=9, fontweight="bold")
    reach = np.abs(np.stack([widths, heights])).max(axis=0)[:, None] / 2
    ax.update_datalim(np.concatenate([means - reach, means + reach]))
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


def plot_history(history: Iterable[Any], *, over: str = "n_components", ax: Axes | None = None) -> Axes:
    """Draw the path of `fit_mixture`: description length and log-likelihood as components are taken away.

    Parameters
    ----------
    history : records with n_components, log_likelihood (nats), description_length (nats), event: MixtureFit.history.
    over : "n_components" for the value reached at each K, the star at the least; "iteration" for every record.

    Raises
    ------
    ValueError
        Another `over`, or no records.
    """
    records = list(history)
    if over not in ("n_components", "iteration") or not records:
        raise ValueError(f"over {over!r}: 'n_components' or 'iteration'; and at least one record, not {len(records)}")
    counts = np.array([record.n_components for record in records])
    lengths = np.array([record.description_length for record in records], dtype=np.float64)
    likelihoods = np.array([record.log_likelihood for record in records], dtype=np.float64)
    ax = ax or plt.subplots()[1]
    x = np.arange(len(records))
    if over == "n_components":
        last = np.flatnonzero(np.append(counts[1:] != counts[:-1], True))
        x, lengths, likelihoods = counts[last], lengths[last], likelihoods[last]
        ax.invert_xaxis()
    ax.plot(x, lengths, color=CYCLE[0], marker="o" if over == "n_components" else "", ms=3, label="description length")
    ax.plot(x, -likelihoods, color=CYCLE[1], ls="--", label="minus log-likelihood")
    best = int(np.argmin(lengths))
    ax.plot(
        x[best],
        lengths[best],
        "*",
        ms=14,
        color=CYCLE[5],
        label=f"least: K = {counts[last][best]}" if over == "n_components" else f"least: K = {counts[best]}",
    )
    ax.set(xlabel="components K" if over == "n_components" else "record", ylabel="nats")
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
    ax.legend()
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


def plot_confusion(confusion: Any, *, title: str = "", ax: Axes | None = None) -> Axes:
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
    published : category -> the paper's value, drawn as a black line across the bars.
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
    handles, labels = ax.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    ax.legend(unique.values(), unique.keys(), loc="upper left", bbox_to_anchor=(1.0, 1.0))
    ax.set(ylabel=ylabel, xticks=range(len(categories)))
    ax.set_xticklabels(categories)
    ax.grid(axis="x", visible=False)
    return ax
