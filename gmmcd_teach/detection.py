"""The paper's whole method on one screen: filter, project, fit, compare, extract (chapter 9)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.em import Record, fit_mixture
from gmmcd_teach.extraction import extract_changes
from gmmcd_teach.filtering import statistical_outlier_mask, voxel_downsample
from gmmcd_teach.mixture import GaussianMixture, generator
from gmmcd_teach.pca import principal_axes
from gmmcd_teach.progress import progress_bar
from gmmcd_teach.starts import check_number

Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
NOTHING = np.empty(0, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Detection:
    """What has changed between two clouds.

    Attributes
    ----------
    appeared : (N_after,) bool over the points of `after` as they were given, whatever was filtered on the way.
    disappeared : (N_before,) bool over the points of `before`.
    before_mixture, after_mixture : the fitted mixtures, None for methods without one.
    appeared_components, disappeared_components : indices into `after_mixture` and `before_mixture`.
    seconds : time spent on "filter", "pca", "em", "emd" or, by other methods, "compare"; and in "total".
    """

    appeared: Bools
    disappeared: Bools
    before_mixture: GaussianMixture | None = None
    after_mixture: GaussianMixture | None = None
    appeared_components: Indices = field(default_factory=NOTHING.copy)
    disappeared_components: Indices = field(default_factory=NOTHING.copy)
    seconds: dict[str, float] = field(default_factory=dict)


class Stopwatch:
    """Seconds spent in each step; `watch("em")` closes the step that ran until now.

    Examples
    --------
    >>> watch = Stopwatch()
    >>> watch("filter")
    >>> sorted(watch.seconds)
    ['em', 'emd', 'filter', 'pca', 'total']
    """

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(("filter", "pca", "em", "emd", "total"), 0.0)
        self.last = perf_counter()

    def __call__(self, step: str) -> None:
        """Add the seconds since the last call to `step` and to the total."""
        now = perf_counter()
        self.seconds[step] = self.seconds.get(step, 0.0) + now - self.last
        self.seconds["total"] += now - self.last
        self.last = now


def detect_greedy(
    before: ArrayLike,
    after: ArrayLike,
    *,
    max_components: int = 25,
    leaf_size: float | None = None,
    outlier_filter: bool = False,
    n_principal_axes: int | None = None,
    rng: int | np.random.Generator = 0,
    progress: bool = False,
    ground: str = "means",
    mass: str = "normalized",
    **em_options: Any,
) -> Detection:
    """EM-EMD: one mixture for each cloud, and greedy extraction in both directions (Algorithm 1).

    Parameters
    ----------
    before, after : (N, D) metres.
    max_components : K at the start of EM.
    leaf_size : metres, edge of the voxel grid; None leaves the clouds as they are.
    outlier_filter : take out statistical outliers first.
    n_principal_axes : project both clouds on the first axes of the two together; None does not project.
    rng : seed or generator of the starts of EM.
    progress : show how far EM has come.
    ground, mass : see `extract_changes`.
    **em_options : see `fit_mixture`.

    Raises
    ------
    CloudError
        A cloud cannot be used, or has fewer points than components after filtering.
    ValueError
        An option is out of range.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> shelf = rng.uniform(0, 1, (300, 2))
    >>> with_box = np.concatenate([rng.uniform(0, 1, (300, 2)), rng.normal(4, 0.1, (60, 2))])
    >>> bool(detect_greedy(shelf, with_box, max_components=4, init="kmeans++").appeared[300:].all())
    True
    """
    check_number("max_components", max_components, 1, whole=True)
    old_cloud = check_points(before, "before")
    clouds = old_cloud, check_points(after, "after", dimensions=old_cloud.shape[1:])
    rng = generator(rng)
    watch = Stopwatch()
    filtered = [prepare(cloud, leaf_size, outlier_filter) for cloud in clouds]
    watch("filter")
    if n_principal_axes is not None:
        if n_principal_axes not in range(1, clouds[0].shape[1] + 1):
            raise ValueError(f"n_principal_axes = {n_principal_axes!r}; expected 1 to {clouds[0].shape[1]}, or None")
        axes = principal_axes(np.concatenate(filtered))
        clouds = axes.project(clouds[0], n_principal_axes), axes.project(clouds[1], n_principal_axes)
        filtered = [axes.project(cloud, n_principal_axes) for cloud in filtered]
    watch("pca")
    with em_progress(2 * max_components, progress) as on_record:
        old, new = (
            fit_named(name, s, max_components, rng=rng, on_record=on_record, **em_options)
            for name, s in zip(("before", "after"), filtered, strict=True)
        )
    watch("em")
    appeared = extract_changes(old, new, ground=ground, mass=mass).indices
    disappeared = extract_changes(new, old, ground=ground, mass=mass).indices
    watch("emd")
    return Detection(
        np.isin(new.assign(clouds[1]), appeared),
        np.isin(old.assign(clouds[0]), disappeared),
        old,
        new,
        appeared,
        disappeared,
        watch.seconds,
    )


def fit_named(name: str, points: Floats, max_components: int, **options: Any) -> GaussianMixture:
    """The mixture of a cloud, by `fit_mixture`; a CloudError says which cloud could not be fitted.

    Examples
    --------
    >>> fit_named("after", np.zeros((9, 3)), 10)
    Traceback (most recent call last):
        ...
    gmmcd_teach.clouds.CloudError: after: 9 points; at least 10 needed
    """
    try:
        return fit_mixture(points, max_components, **options).mixture
    except CloudError as error:
        raise CloudError(f"{name}: {str(error).removeprefix('points: ')}") from None


@contextmanager
def em_progress(total: int, shown: bool) -> Iterator[Callable[[Record], None]]:
    """A bar that advances as EM comes down its path, `total` components in all.

    Examples
    --------
    >>> with em_progress(25, False) as on_record:
    ...     fit = fit_mixture(np.random.default_rng(0).normal(size=(500, 2)), on_record=on_record)
    """
    with progress_bar(total=total, desc="EM", unit="component", shown=shown, leave=False) as bar:

        def on_record(record: Record) -> None:
            if record.event in ("start", "removed"):
                bar.update(1)
                bar.set_postfix(K=record.n_components)

        yield on_record


def prepare(points: Floats, leaf_size: float | None, outlier_filter: bool) -> Floats:
    """(M, D) points without statistical outliers and thinned to one per voxel, as asked."""
    if outlier_filter:
        points = points[statistical_outlier_mask(points)]
    return points if leaf_size is None else voxel_downsample(points, leaf_size).centroids
