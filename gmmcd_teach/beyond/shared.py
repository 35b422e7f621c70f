"""One mixture for both clouds: a component whose points come from one scan alone has changed (chapter 15)."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog
from scipy.spatial import KDTree
from scipy.stats import binom

from gmmcd_teach.beyond.baselines import check_lengths, check_sizes
from gmmcd_teach.beyond.surface import nearest
from gmmcd_teach.beyond.visibility import check_frames, check_origin, looks
from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.detection import Bools, Detection, Stopwatch, em_progress, prepare
from gmmcd_teach.em import fit_mixture
from gmmcd_teach.filtering import voxel_downsample
from gmmcd_teach.lab.pair import DepthFrame
from gmmcd_teach.mixture import GaussianMixture, floats
from gmmcd_teach.starts import check_number, is_above_zero

SEEN_THROUGH = 0.25  # share of a component that the other scan must have looked past, for it to have changed
TOL = 1e-4  # the floor blurs what more steps of EM would tell


def detect_shared(
    before: ArrayLike,
    after: ArrayLike,
    *,
    max_components: int = 25,
    leaf_size: float | None = None,
    outlier_filter: bool = False,
    before_origin: ArrayLike | None = None,
    after_origin: ArrayLike | None = None,
    rng: int | np.random.Generator = 0,
    progress: bool = False,
    before_frames: Sequence[DepthFrame] | None = None,
    after_frames: Sequence[DepthFrame] | None = None,
    alignment_error: float = 0.02,
    share: float | None = None,
    false_alarms: float = 0.05,
    patch_size: float | None = None,
    init: str | GaussianMixture = "kmeans++",
    **em_options: Any,
) -> Detection:
    """Fit one mixture to both clouds together, then ask of each component which cloud its points are from.

    A wall that is a centimetre off would be told as two parallel sheets, one for each scan. So the covariances are
    given a floor, the square of the alignment error: no component is thinner than what misalignment explains. The
    fit sees one point for each patch of surface, since points that are next to each other tell the same thing twice.

    Parameters
    ----------
    before, after : (N, D) metres.
    max_components : K for each cloud; the common mixture starts with twice as many.
    leaf_size, outlier_filter : thin and filter the clouds first.
    before_origin, after_origin : (3,) metres, and
    before_frames, after_frames : the depth frames: where one of the two is told, a component has changed only if the
        other scan looked past a quarter of its patches, and past no fewer than it met again; and patches of the other
        scan count only where they were met again, not where they are new or have come out of hiding. No frames at all
        are as good as not told.
    rng, progress : seed of the start of EM; show how far it has come.
    alignment_error : metres, how far the clouds may be off each other.
    share : of a component's patches that one cloud must hold for the other to lack it, above 0.5. None takes 0.7, or
        0.9 where no sensor is told and a shadow may look like a change.
    false_alarms : how many components may be called changed by chance in a scene without change, expected number.
    patch_size : metres, edge of a patch, within which points repeat each other; None takes 1.5 alignment errors.
    init, **em_options : see `fit_mixture`.

    Returns
    -------
    Detection whose two mixtures have the same components and each side's own weights.

    Raises
    ------
    CloudError
        A cloud, an origin or a frame cannot be used, or the clouds differ in dimension.
    ValueError
        An option is out of range.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> room = rng.uniform(0, 1, (800, 2))
    >>> found = detect_shared(room, np.concatenate([room, rng.normal(3, 0.1, (200, 2))]), max_components=4)
    >>> bool(found.appeared[800:].all()), bool(found.appeared[:800].any())
    (True, False)
    """
    check_lengths(alignment_error=alignment_error)
    check_sizes(leaf_size=leaf_size, patch_size=patch_size)
    check_number("max_components", max_components, 1, whole=True)
    before_frames = check_frames(before_frames, "before_frames")
    after_frames = check_frames(after_frames, "after_frames")
    old = check_points(before, "before", dimensions=(3,) if before_frames or after_frames else ())
    clouds = old, check_points(after, "after", dimensions=old.shape[1:])
    before_origin = check_origin(before_origin, "before_origin", old.shape[1])
    after_origin = check_origin(after_origin, "after_origin", old.shape[1])
    told = any(x is not None for x in (before_origin, after_origin, before_frames, after_frames))
    share = share if share is not None else 0.7 if told else 0.9
    if not (isinstance(share, Real) and 0.5 < share < 1):
        raise ValueError(f"share = {share!r}; expected a number between 0.5 and 1")
    if not is_above_zero(false_alarms):
        raise ValueError(f"false_alarms = {false_alarms!r}; expected a number of components above 0")
    watch = Stopwatch()
    patch = patch_size or 1.5 * max(alignment_error, 1e-3)
    old, new = (prepare(cloud, leaf_size, outlier_filter) for cloud in clouds)
    patches = [surface_patches(cloud, patch) for cloud in (old, new)]
    watch("filter")
    em_options = {"tol": TOL, "covariance_floor": max(alignment_error, 1e-3) ** 2, **em_options}
    together = np.concatenate(patches)
    with em_progress(2 * max_components, progress) as on_record:
        mixture = fit_mixture(
            together,
            min(2 * max_components, len(together)),
            init=init,
            rng=rng,
            on_record=on_record,
            **em_options,
        ).mixture
    watch("em")
    said = (
        other_scan_says(patches[0], new, after_origin, after_frames, patch),
        other_scan_says(patches[1], old, before_origin, before_frames, patch),
    )
    held, past, met = zip(*(votes(mixture, *asked) for asked in zip(patches, said, strict=True)), strict=True)
    fewest = np.log2(2 * mixture.n_components / false_alarms)  # fewer patches, though of one scan, may be chance
    sides = [one_side(mixture, *scan, fewest) for scan in zip(held, patches, strict=True)]
    gone = changed_components(held[0], met[1], share, false_alarms)[0]
    come = changed_components(met[0], held[1], share, false_alarms)[1]
    for i, changed in enumerate((gone, come)):
        changed &= (past[i] >= np.maximum(met[i], SEEN_THROUGH * held[i])) & (sides[i].weights > 0)
    watch("compare")
    return Detection(
        come[sides[1].assign(clouds[1])],
        gone[sides[0].assign(clouds[0])],
        sides[0],
        sides[1],
        np.flatnonzero(come),
        np.flatnonzero(gone),
        watch.seconds,
    )


def surface_patches(cloud: Floats, size: float) -> Floats:
    """Centroids (M, D) of the cells of this size; where most cells hold several points, one alone is no surface.

    At an outline a pixel may see two surfaces at once, and report a depth between them. Such points are few and far
    between, and would make components of their own.

    Examples
    --------
    >>> surface_patches(np.array([[0.1], [0.2], [1.1], [1.2], [2.5]]), 1.0)
    array([[0.15],
           [1.15]])
    """
    voxels = voxel_downsample(cloud, size)
    return voxels.centroids[voxels.counts >= min(2, np.median(voxels.counts))]


def other_scan_says(
    patches: Floats, scan: Floats, origin: ArrayLike | None, frames: Sequence[DepthFrame] | None, margin: float
) -> tuple[Bools, Bools]:
    """Which patches (M,) the other scan has looked past, and which it has met again; neither: hidden.

    Of a scan that does not tell where its sensor was nothing is known: all patches count as both.

    Examples
    --------
    >>> wall = np.stack(np.meshgrid(np.linspace(-1, 1, 50), np.linspace(-1, 1, 50), [2.0]), -1).reshape(-1, 3)
    >>> past, met = other_scan_says(np.array([[0, 0, 1.0], [0, 0, 2.0], [0, 0, 3.0]]), wall, np.zeros(3), None, 0.1)
    >>> past.tolist(), met.tolist()
    ([True, False, False], [False, True, False])
    """
    if origin is None and frames is None:
        return np.ones(len(patches), dtype=bool), np.ones(len(patches), dtype=bool)
    seen = looks(patches, scan, origin, frames, margin)
    near = nearest(KDTree(scan), patches)[0][:, 0] < margin
    past = (seen.past > seen.met) & ~near
    return past, near | ((seen.met > 0) & ~past)


def votes(mixture: GaussianMixture, patches: Floats, said: tuple[Bools, Bools]) -> Floats:
    """(3, K): how many of the patches (M, D) each component holds, and how many of these were looked past, and met.

    Examples
    --------
    >>> pair = GaussianMixture([0.5, 0.5], [[0.0], [9.0]], [[[1.0]], [[1.0]]])
    >>> past, met = np.array([[False, False, True], [True, False, False]])
    >>> votes(pair, np.array([[0.1], [8.8], [9.1]]), (past, met)).tolist()
    [[1.0, 2.0], [0.0, 1.0], [1.0, 0.0]]
    """
    member, k = mixture.assign(patches), mixture.n_components
    return np.array([np.bincount(member, flags, k) for flags in (np.ones(len(member)), *said)], dtype=np.float64)


def one_side(mixture: GaussianMixture, held: Floats, patches: Floats, fewest: float) -> GaussianMixture:
    """The mixture with the weights of one scan: the share of its patches (M, D) that each component holds, (K,).

    As in EM, a component with too little support is annihilated (Eq. 12), and its patches go to the others.

    Examples
    --------
    >>> pair = GaussianMixture([0.5, 0.5], [[0.0], [9.0]], [[[1.0]], [[1.0]]])
    >>> one_side(pair, np.array([3.0, 1.0]), np.array([[0.1], [0.2], [-0.1], [9.0]]), fewest=2).weights
    array([1., 0.])
    """
    own = GaussianMixture(held / held.sum(), mixture.means, mixture.covariances)
    counts = np.bincount(own.assign(patches), minlength=len(held))
    kept = np.where(counts > min(fewest, counts.max() - 1), counts, 0)
    return GaussianMixture(kept / kept.sum(), mixture.means, mixture.covariances)


def changed_components(before: ArrayLike, after: ArrayLike, share: float, false_alarms: float) -> tuple[Bools, Bools]:
    """Which components (K,) have gone, and which have come, by how many patches of each cloud they hold, (K,) each.

    Neighbouring points repeat each other, so what is counted is patches of surface. In a component that has not
    changed each patch is as likely to be from one cloud as from the other: the count is binomial. A component has
    changed where so uneven a count has a chance below `false_alarms` / 2K (Bonferroni), and where one cloud holds at
    least `share` of it: with many patches a shadow on a wall is significant, too, but it is no change.

    Examples
    --------
    >>> changed_components([40, 0, 3, 10], [42, 30, 0, 30], 0.9, 0.01)
    (array([False, False, False, False]), array([False,  True, False, False]))
    """
    old, new = floats(before, "before"), floats(after, "after")
    level = false_alarms / (2 * len(old))
    total = old + new

    def lacks(less: Floats, more: Floats) -> Bools:
        return np.asarray((binom.cdf(less, total, 0.5) < level) & (more >= share * total))

    return lacks(new, old), lacks(old, new)


def unbalanced_emd(
    weights_p: ArrayLike, weights_q: ArrayLike, ground_distance: ArrayLike, price: float
) -> tuple[Floats, Floats, Floats]:
    """The cheapest way to turn p into q where mass may also be destroyed or created, at a price for each unit.

    One linear programme finds disappearances and appearances together: mass that is farther than twice the price
    from all that lacks mass is destroyed here and created there (partial transport; Figalli 2010).

    Parameters
    ----------
    weights_p, weights_q : (K,) and (L,) masses, not normalised.
    ground_distance : (K, L) metres.
    price : metres, what creating or destroying a unit of mass costs.

    Returns
    -------
    flow (K, L), destroyed (K,), created (L,)

    Raises
    ------
    CloudError
        Masses or ground distances of the wrong shape.
    ValueError
        The price is not a length.

    Examples
    --------
    >>> flow, destroyed, created = unbalanced_emd([1, 1], [1, 2], [[0.0, 5.0], [5.0, 4.0]], price=1.0)
    >>> destroyed.tolist(), created.tolist()
    ([0.0, 1.0], [0.0, 2.0])
    """
    check_lengths(price=price)
    p, q = floats(weights_p, "weights_p"), floats(weights_q, "weights_q")
    cost = floats(ground_distance, "ground_distance")
    if p.ndim != 1 or q.ndim != 1 or cost.shape != (len(p), len(q)):
        raise CloudError(f"ground_distance: shape {cost.shape}; expected ({p.size}, {q.size})")
    k, m = cost.shape
    gain = (cost - 2 * price).ravel()  # a unit carried saves one destroyed and one created
    sums = np.vstack([np.kron(np.eye(k), np.ones(m)), np.kron(np.ones(k), np.eye(m))])  # (K + L, K L)
    answer = linprog(gain, A_ub=sums, b_ub=np.concatenate([p, q]), method="highs")
    if answer.x is None:
        raise RuntimeError(f"linprog found no optimal flow: {answer.message}")
    flow = answer.x.reshape(k, m)
    return flow, p - flow.sum(axis=1), q - flow.sum(axis=0)
