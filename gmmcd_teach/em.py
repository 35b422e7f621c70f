"""Expectation-Maximization that chooses its own number of components (chapters 5 and 6).

The logarithm of a Gaussian is linear in the features 1, x_i, x_i x_j of a point. So one matrix product gives all
log-densities (E-step), and one more gives all the sums that the M-step needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach import batch, componentwise
from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.features import Block, average_over_cells, blocks_of, quadratic_features
from gmmcd_teach.mixture import LARGEST, GaussianMixture, floats

UPDATES: dict[str, ModuleType] = {"batch": batch, "componentwise": componentwise}


@dataclass(frozen=True)
class Record:
    """One line of a fit's history.

    Attributes
    ----------
    n_components : K at that moment.
    log_likelihood, description_length : of the mixture at that moment, nats.
    event : "start", "step" (an M-step), "annihilated" (an M-step in which components died), "removed" (the weakest was
        taken out by force, and EM starts anew with one fewer) or "polish" (a step on all points after a path on cells).
    """

    n_components: int
    log_likelihood: float
    description_length: float
    event: str


@dataclass(frozen=True, eq=False)
class MixtureFit:
    """The mixture of least description length, and the path that led to it."""

    mixture: GaussianMixture
    description_length: float
    log_likelihood: float
    history: tuple[Record, ...]


def n_parameters(n_dimensions: int) -> int:
    """P, the numbers that specify one Gaussian: D for its mean and D (D + 1) / 2 for its covariance (Eq. 13).

    Examples
    --------
    >>> n_parameters(3), n_parameters(2)
    (9, 5)
    """
    return n_dimensions + n_dimensions * (n_dimensions + 1) // 2


def mdl_penalty(weights: ArrayLike, n_points: float, n_dimensions: int) -> float:
    """What the parameters cost, in nats: p(k) of Eq. 16 with log(N / 12), as Figueiredo & Jain (2002) have it.

    Components of weight 0 cost nothing.

    Examples
    --------
    >>> round(mdl_penalty([1.0], 12, 3), 6)
    5.0
    """
    alpha = np.asarray(weights, dtype=np.float64)
    alpha = alpha[alpha > 0]
    k, p = len(alpha), n_parameters(n_dimensions)
    return float(p / 2 * np.log(n_points * alpha / 12).sum() + k / 2 * np.log(n_points / 12) + k * (p + 1) / 2)


def description_length(mixture: GaussianMixture, points: ArrayLike) -> float:
    """Nats that the mixture and then the points take to tell: penalty minus log-likelihood (Eqs. 15 to 17).

    Raises
    ------
    CloudError
        The points, (N, D) in metres, cannot be used or do not have the mixture's dimension.

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[0.0]], [[[1.0]]])
    >>> round(description_length(one, np.zeros((12, 1))), 4)
    12.5273
    """
    s = check_points(points)
    return mdl_penalty(mixture.weights, len(s), mixture.n_dimensions) - mixture.log_likelihood(s)


def fit_mixture(
    points: ArrayLike,
    max_components: int = 25,
    min_components: int = 1,
    *,
    tol: float = 1e-5,
    max_iter: int = 100,
    update: str = "batch",
    init: str = "random",
    point_weights: ArrayLike | None = None,
    cell_size: float | None = None,
    covariance_floor: float = 1e-6,
    rng: int | np.random.Generator = 0,
    on_record: Callable[[Record], None] | None = None,
) -> MixtureFit:
    """Fit Gaussian mixtures from max_components down to min_components and keep the shortest description.

    EM converges at some K; the weakest component is taken out; EM goes on with K - 1 (Figueiredo & Jain 2002). On the
    way the modified M-step annihilates components that fewer than P / 2 points support (Eqs. 11 and 12).

    Parameters
    ----------
    points : (N, D) metres, N >= max_components.
    max_components, min_components : K and K_min. Where they are equal K stays fixed and every M-step is the plain one.
    tol : tau: EM at one K ends when the log-likelihood changes by less than this share of itself (Eq. 14: absolute).
    max_iter : L, the most M-steps at each K.
    update : "batch" changes all components at once (the paper), "componentwise" one after the other (its code).
    init : "random" or "kmeans++", how the first means are drawn from the points.
    point_weights : (N,) how many points each one stands for; N in the description length is their sum.
    cell_size : metres: follow the path on the averages over cubes of this size, then polish on all points.
    covariance_floor : square metres, added to the diagonal of every covariance.
    rng : seed or generator of the starting means.
    on_record : called with each new line of the history, to show progress.

    Raises
    ------
    CloudError
        The points or their weights cannot be used, there are too few, or a covariance became singular.
    ValueError
        An option is out of range; the message names those allowed.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> two = np.concatenate([rng.normal(0, 1, (400, 2)), rng.normal(9, 1, (400, 2))])
    >>> fit_mixture(two, max_components=8, init="kmeans++").mixture.n_components
    2
    """
    check_options(max_components, min_components, tol, max_iter, update, init, cell_size, covariance_floor)
    s = check_points(points, minimum=max_components)
    counts = check_weights(point_weights, len(s), max_components)
    centre = np.median(s, axis=0)  # far from the origin the squares would lose their digits
    s = s - centre
    if np.abs(s).max() > LARGEST:
        raise CloudError(f"points: coordinates beyond {LARGEST:.0e} m; their squares overflow")

    features = quadratic_features(s)  # (F, N)
    blocks = blocks_of(features, counts)
    start = starting_mixture(s, counts, max_components, init, covariance_floor, np.random.default_rng(rng))
    run = EMRun(UPDATES[update], min_components, tol, max_iter, covariance_floor, on_record)
    if cell_size is None:
        fit = run.path(start, blocks)
    else:
        cells = blocks_of(*average_over_cells(s, features, counts, cell_size))
        fit = run.polish(run.path(start, cells), blocks)
    log_likelihood = float(counts @ fit.mixture.log_density(s))  # from each mean: no digits lost to squares
    length = mdl_penalty(fit.mixture.weights, counts.sum(), s.shape[1]) - log_likelihood
    moved = GaussianMixture(fit.mixture.weights, fit.mixture.means + centre, fit.mixture.covariances)
    return MixtureFit(moved, length, log_likelihood, fit.history)


@dataclass(frozen=True)
class EMRun:
    """EM with its settings; `update` brings the two steps, `expect` and `maximise`."""

    update: ModuleType
    min_components: int
    tol: float
    max_iter: int
    covariance_floor: float
    on_record: Callable[[Record], None] | None = None

    def path(self, mixture: GaussianMixture, blocks: list[Block]) -> MixtureFit:
        """Converge, take the weakest out, converge again, down to min_components; return the best mixture met."""
        history: list[Record] = []
        best: MixtureFit | None = None
        event = "start"
        while True:
            here = self.converge(mixture, blocks, (event, "step"))
            history += here.history
            if best is None or here.description_length < best.description_length:
                best = here
            mixture = here.mixture
            if mixture.n_components <= self.min_components:
                return MixtureFit(best.mixture, best.description_length, best.log_likelihood, tuple(history))
            mixture = mixture.subset(np.delete(np.arange(mixture.n_components), mixture.weights.argmin()))
            event = "removed"

    def polish(self, fit: MixtureFit, blocks: list[Block]) -> MixtureFit:
        """Let EM run on all points from the mixture that won on cells."""
        last = self.converge(fit.mixture, blocks, ("polish", "polish"))
        return MixtureFit(last.mixture, last.description_length, last.log_likelihood, fit.history + last.history)

    def converge(self, mixture: GaussianMixture, blocks: list[Block], events: tuple[str, str]) -> MixtureFit:
        """E-steps and M-steps in turn, uphill (Eq. 5), until the log-likelihood stands still or max_iter is reached."""
        n_points = sum(float(block.counts.sum()) for block in blocks)

        def note(event: str) -> None:
            penalty = mdl_penalty(mixture.weights, n_points, mixture.n_dimensions)
            history.append(Record(mixture.n_components, log_likelihood, penalty - log_likelihood, event))
            if self.on_record is not None:
                self.on_record(history[-1])

        history: list[Record] = []
        log_likelihood, expected = self.update.expect(mixture, blocks)
        note(events[0])
        steps = 0
        while steps < self.max_iter:
            k, before = mixture.n_components, log_likelihood
            mixture = self.update.maximise(mixture, expected, blocks, self.min_components, self.covariance_floor)
            log_likelihood, expected = self.update.expect(mixture, blocks)
            died = mixture.n_components < k
            note("annihilated" if died else events[1])
            steps = 1 if died else steps + 1  # L counts anew at each K
            if not died and abs(log_likelihood - before) < self.tol * abs(log_likelihood):
                break
        return MixtureFit(mixture, history[-1].description_length, log_likelihood, tuple(history))


def starting_mixture(
    points: Floats, counts: Floats, n_components: int, init: str, covariance_floor: float, rng: np.random.Generator
) -> GaussianMixture:
    """K equal round Gaussians on points drawn at random, a tenth of the largest variance each (Figueiredo & Jain).

    "kmeans++" draws each next mean with a probability that grows with the squared distance to those drawn before
    (Arthur & Vassilvitskii 2007).

    Examples
    --------
    >>> line = np.arange(10.0)[:, None]
    >>> start = starting_mixture(line, np.ones(10), 3, "random", 0.0, np.random.default_rng(0))
    >>> start.weights.round(3), start.covariances.round(3)[0]
    (array([0.333, 0.333, 0.333]), array([[0.825]]))
    """
    n, d = points.shape
    share = counts / counts.sum()
    if init == "random":
        chosen = rng.choice(n, size=n_components, replace=False, p=share)
    else:
        nearest = np.ones(n)  # squared distance to the nearest mean drawn so far
        chosen = np.empty(n_components, dtype=np.intp)
        for k in range(n_components):
            chance = share * nearest if (share * nearest).sum() > 0 else share  # all points taken: identical ones
            chosen[k] = rng.choice(n, p=chance / chance.sum())
            distance = ((points - points[chosen[k]]) ** 2).sum(axis=1)
            nearest = distance if k == 0 else np.minimum(nearest, distance)
    variance = (share @ (points - share @ points) ** 2).max() / 10 + covariance_floor
    return GaussianMixture(
        np.full(n_components, 1 / n_components),
        points[chosen],
        np.broadcast_to(variance * np.eye(d), (n_components, d, d)),
    )


def check_options(
    max_components: int,
    min_components: int,
    tol: float,
    max_iter: int,
    update: str,
    init: str,
    cell_size: float | None,
    covariance_floor: float,
) -> None:
    """Raise a ValueError that names the first option of `fit_mixture` out of range, and the range.

    Examples
    --------
    >>> check_options(5, 1, 1e-5, 100, "batch", "random", None, 0.0)
    """
    for name, value, lowest in (
        ("max_components", max_components, 1),
        ("min_components", min_components, 1),
        ("max_iter", max_iter, 1),
        ("tol", tol, 0),
        ("covariance_floor", covariance_floor, 0),
    ):
        whole = name not in ("tol", "covariance_floor")
        if not isinstance(value, Integral if whole else Real) or not lowest <= value < np.inf:
            raise ValueError(f"{name} = {value!r}; expected a {'whole ' if whole else ''}number of at least {lowest}")
    if min_components > max_components:
        raise ValueError(f"min_components = {min_components}; expected at most max_components = {max_components}")
    for name, chosen, allowed in (("update", update, tuple(UPDATES)), ("init", init, ("random", "kmeans++"))):
        if chosen not in allowed:
            raise ValueError(f"{name} = {chosen!r}; expected one of {', '.join(map(repr, allowed))}")
    if cell_size is not None and not (isinstance(cell_size, Real) and 0 < cell_size < np.inf):
        raise ValueError(f"cell_size = {cell_size!r}; expected metres above 0, or None")


def check_weights(weights: ArrayLike | None, n_points: int, n_components: int, name: str = "point_weights") -> Floats:
    """(N,) weights as float64, ones by default; a CloudError where they are not one finite weight >= 0 a point.

    Examples
    --------
    >>> check_weights(None, 3, 1)
    array([1., 1., 1.])
    """
    counts = np.ones(n_points) if weights is None else floats(weights, name)
    if counts.shape != (n_points,):
        raise CloudError(f"{name}: shape {counts.shape}; expected ({n_points},)")
    if not np.isfinite(counts).all() or counts.min() < 0:
        raise CloudError(f"{name}: from {counts.min():.3g} to {counts.max():.3g}; expected finite weights >= 0")
    above = np.count_nonzero(counts)
    if above < n_components:
        raise CloudError(
            f"{name}: {above} weights above zero; at least one for each of {n_components} components needed"
        )
    return counts
