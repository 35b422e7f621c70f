"""Expectation-Maximization that chooses its own number of components (chapters 5 and 6).

The logarithm of a Gaussian is linear in the features 1, x_i, x_i x_j of a point. So one matrix product gives all
log-densities (E-step), and one more gives all the sums that the M-step needs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach import batch, componentwise
from gmmcd_teach.clouds import CloudError, check_points
from gmmcd_teach.features import Blocks, average_over_cells, block_size, blocks_of, quadratic_features
from gmmcd_teach.mdl import mdl_penalty
from gmmcd_teach.mixture import LARGEST, GaussianMixture, generator
from gmmcd_teach.starts import check_options, check_weights, starting_mixture

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


def fit_mixture(
    points: ArrayLike,
    max_components: int = 25,
    min_components: int = 1,
    *,
    tol: float = 1e-5,
    max_iter: int = 100,
    update: str = "batch",
    init: str | GaussianMixture = "random",
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
    init : "random" or "kmeans++", how the first means are drawn from the points; or the mixture to start from, of
        max_components components.
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
    dimensions = (init.n_dimensions,) if isinstance(init, GaussianMixture) else ()
    s = check_points(points, minimum=max_components, dimensions=dimensions)
    counts = check_weights(point_weights, len(s), max_components)
    centre = np.median(s, axis=0)  # far from the origin the squares would lose their digits
    s = s - centre
    if np.abs(s).max() > LARGEST:
        raise CloudError(f"points: coordinates beyond {LARGEST:.0e} m; their squares overflow")

    features = quadratic_features(s)  # (F, N)
    blocks = blocks_of(features, counts, block_size(max_components))
    if isinstance(init, GaussianMixture):
        start = init.moved(-centre)
    else:
        start = starting_mixture(s, counts, max_components, init, covariance_floor, generator(rng))
    run = EMRun(UPDATES[update], min_components, tol, max_iter, covariance_floor, on_record)
    if cell_size is None:
        fit = run.path(start, blocks)
    else:
        cells = blocks_of(*average_over_cells(s, features, counts, cell_size), block_size(max_components))
        fit = run.polish(run.path(start, cells), blocks)
    log_likelihood = float(counts @ fit.mixture.log_density(s))  # from each mean: no digits lost to squares
    length = mdl_penalty(fit.mixture.weights, counts.sum(), s.shape[1]) - log_likelihood
    return MixtureFit(fit.mixture.moved(centre), length, log_likelihood, fit.history)


@dataclass(frozen=True)
class EMRun:
    """EM with its settings; `update` brings the two steps, `expect` and `maximise`."""

    update: ModuleType
    min_components: int
    tol: float
    max_iter: int
    covariance_floor: float
    on_record: Callable[[Record], None] | None = None

    def path(self, mixture: GaussianMixture, blocks: Blocks) -> MixtureFit:
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

    def polish(self, fit: MixtureFit, blocks: Blocks) -> MixtureFit:
        """Let EM run on all points from the mixture that won on cells."""
        last = self.converge(fit.mixture, blocks, ("polish", "polish"))
        return MixtureFit(last.mixture, last.description_length, last.log_likelihood, fit.history + last.history)

    def converge(self, mixture: GaussianMixture, blocks: Blocks, events: tuple[str, str]) -> MixtureFit:
        """E-steps and M-steps in turn, uphill (Eq. 5), until the log-likelihood stands still or max_iter is reached."""
        n_points = float(blocks.counts.sum())

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
