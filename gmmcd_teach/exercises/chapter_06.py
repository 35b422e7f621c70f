"""Exercises of chapter 6: how many components."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from gmmcd_teach.clouds import Floats
from gmmcd_teach.exercises.checking import Exercise, Mistake, register
from gmmcd_teach.mdl import description_length, mdl_penalty, n_parameters
from gmmcd_teach.mixture import GaussianMixture

Settle = Callable[[Floats, GaussianMixture], GaussianMixture]


def annihilating_weights(support: Floats, d: int) -> Floats:
    """(K,) weights of Eq. 11 from the support of each component."""
    return over_sum(np.maximum(0, support - n_parameters(d) / 2))


def over_sum(raw: Floats) -> Floats:
    """An array divided by its sum."""
    return np.asarray(raw / raw.sum())


def message_length(weights: Floats, n: int, d: int, log_likelihood: float) -> float:
    """The cost of Eq. 17."""
    return mdl_penalty(weights, n, d) - log_likelihood


def price_without(part: str, weights: Floats, n: int, d: int) -> float:
    """The price of Eq. 16 with one part wrong."""
    alpha = weights[weights > 0]
    k, p = len(alpha), n_parameters(d)
    price = mdl_penalty(weights, n, d)
    wrong = {
        "12": k / 2 * np.log(6),
        "constants": (p + 1) / 2 * k * (np.log(12) - 1),
        "n in the sum": -p / 2 * k * np.log(n),
        "dead": (len(weights) - k) * (np.log(n / 12) + p + 1) / 2,
        "numbers": -p / 2 * np.log(n * alpha / 12).sum(),
    }
    return float(price + wrong[part])


def shortest(points: Floats, mixture: GaussianMixture, settle: Settle) -> tuple[int, float]:
    """K and description length of the best mixture on the path down to one component."""
    found = path(points, mixture, settle)
    best = min(found, key=lambda m: description_length(m, points))
    return best.n_components, description_length(best, points)


def path(
    points: Floats, mixture: GaussianMixture, settle: Settle, pick: Callable[[Floats], np.intp] = np.argmin
) -> list[GaussianMixture]:
    """The mixtures at which EM stood still, the picked component removed after each."""
    found = [settle(points, mixture)]
    while found[-1].n_components > 1:
        last = found[-1]
        found.append(settle(points, last.subset(np.delete(np.arange(last.n_components), pick(last.weights)))))
    return found


def with_length(points: Floats, mixture: GaussianMixture) -> tuple[int, float]:
    """K and description length of one mixture."""
    return mixture.n_components, description_length(mixture, points)


def at_first_rise(points: Floats, mixture: GaussianMixture, settle: Settle) -> tuple[int, float]:
    """The mistake of stopping when the description length rises for the first time."""
    found = path(points, mixture, settle)
    lengths = [description_length(m, points) for m in found]
    rise = next((i for i in range(1, len(found)) if lengths[i] > lengths[i - 1]), len(found))
    return with_length(points, found[rise - 1])


def counted_down(points: Floats, mixture: GaussianMixture, settle: Settle) -> tuple[int, float]:
    """The mistake of taking the number of the turn for the number of components."""
    found = []
    for k in range(mixture.n_components, 0, -1):
        mixture = settle(points, mixture)
        found.append((description_length(mixture, points), k))
        if mixture.n_components > 1:
            mixture = mixture.subset(np.delete(np.arange(mixture.n_components), mixture.weights.argmin()))
    length, best = min(found)
    return best, length


def unsettled(points: Floats, mixture: GaussianMixture, settle: Settle) -> tuple[int, float]:
    """The mistake of removing one component after the other with no EM between."""
    return shortest(points, settle(points, mixture), lambda s, m: m)


def three_steps(points: Floats, mixture: GaussianMixture) -> GaussianMixture:
    """EM that is given three steps; one of the two that the checks use for `settle`."""
    for _ in range(3):
        w = mixture.responsibilities(points)
        support = w.sum(axis=0)
        means = w.T @ points / support[:, None]
        x = points[:, None] - means
        covariances = np.einsum("nk,nki,nkj->kij", w, x, x) / support[:, None, None]
        mixture = GaussianMixture(support / support.sum(), means, covariances + 1e-3 * np.eye(points.shape[1]))
    return mixture


def three_steps_and_a_cut(points: Floats, mixture: GaussianMixture) -> GaussianMixture:
    """As `three_steps`, but components that explain fewer than nine points are dropped: K may fall by itself."""
    mixture = three_steps(points, mixture)
    support = mixture.responsibilities(points).sum(axis=0)
    return mixture.subset(np.flatnonzero(support >= min(9, support.max())))


def path_cases() -> Iterator[tuple[Floats, GaussianMixture, Settle]]:
    """Each start, once with a `settle` that keeps all components and once with one that drops the weak."""
    for settle in (three_steps, three_steps_and_a_cut):
        for points, mixture in starts():
            yield points, mixture, settle


def starts() -> Iterator[tuple[Floats, GaussianMixture]]:
    """Points in a few groups, and a mixture of too many components; on the last, every mistake ends elsewhere."""
    for seed in (4, 5, 6):
        rng = np.random.default_rng(seed)
        groups = rng.integers(2, 6)
        points = np.concatenate(
            [
                rng.normal(rng.normal(0, 2, 2), rng.uniform(0.2, 1.2), size=(rng.integers(8, 30), 2))
                for _ in range(groups)
            ]
        )
        means = points[rng.choice(len(points), 7, replace=False)]
        yield points, GaussianMixture(np.full(7, 1 / 7), means, np.tile(np.eye(2), (7, 1, 1)))


register(
    Exercise(
        "ex-06-1",
        lambda: (
            (np.array([40.0, 3.0, 17.5]), 3),
            (np.array([2.4, 9.0, 30.0, 2.6]), 2),
            (np.array([6.0, 4.4, 4.6, 100.0, 0.1]), 3),
        ),
        annihilating_weights,
        (
            Mistake(
                "the maximum with 0 is missing: a weak component gets a negative weight, and the others sum to more "
                "than 1. Use np.maximum(0, ...); np.max(x, axis=0) does not do that",
                lambda support, d: over_sum(support - n_parameters(d) / 2),
            ),
            Mistake(
                "you took P points off; the formula takes P / 2",
                lambda support, d: over_sum(np.maximum(0, support - n_parameters(d))),
            ),
            Mistake(
                "the weights do not sum to 1: divide by the sum of what is left, after the maximum",
                lambda support, d: np.maximum(0, support - n_parameters(d) / 2),
            ),
            Mistake(
                "you divided by the sum of the supports. The divisor of Eq. 11 has P / 2 taken off, too: "
                "divide by the sum of what is above the line",
                lambda support, d: np.maximum(0, support - n_parameters(d) / 2) / support.sum(),
            ),
            Mistake(
                "nothing was taken off: those are the plain weights of chapter 5, and no component ever dies",
                lambda support, d: over_sum(support),
            ),
            Mistake(
                "P is too large: a covariance is symmetric, so it has D (D + 1) / 2 numbers, not D * D",
                lambda support, d: over_sum(np.maximum(0, support - (d + d * d) / 2)),
            ),
            Mistake(
                "the dead are right, but the survivors kept their whole support: P / 2 is taken off those, too",
                lambda support, d: over_sum(np.where(support > n_parameters(d) / 2, support, 0)),
            ),
        ),
    ),
    Exercise(
        "ex-06-2",
        lambda: (
            (np.array([0.5, 0.3, 0.2]), 900, 3, -1234.5),
            (np.array([0.7, 0.0, 0.3]), 400, 2, 321.0),
            (np.array([0.25, 0.25, 0.0, 0.5, 0.0]), 5000, 3, 80.0),
        ),
        message_length,
        (
            Mistake(
                "the sign of the log-likelihood is turned around: a likely cloud makes the message shorter",
                lambda a, n, d, value: mdl_penalty(a, n, d) + value,
            ),
            Mistake(
                "that is the price of the mixture alone. Take the log-likelihood off: the points have to be told, too",
                lambda a, n, d, value: mdl_penalty(a, n, d),
            ),
            Mistake(
                "log(N / 2) as the paper prints it charges log(6) / 2 nats too much for each component: "
                "write log(N / 12)",
                lambda a, n, d, value: price_without("12", a, n, d) - value,
            ),
            Mistake(
                "the constants are missing, as in the published code: divide by 12 in the logarithms, "
                "and add k (P + 1) / 2",
                lambda a, n, d, value: price_without("constants", a, n, d) - value,
            ),
            Mistake(
                "N is missing in the sum: the logarithm is of N alpha / 12, points of the component, not its share",
                lambda a, n, d, value: price_without("n in the sum", a, n, d) - value,
            ),
            Mistake(
                "you counted the dead: k is the number of weights above 0, not len(weights)",
                lambda a, n, d, value: price_without("dead", a, n, d) - value,
            ),
            Mistake(
                "the sum over components is missing: each component's P numbers cost P / 2 log(N alpha / 12)",
                lambda a, n, d, value: price_without("numbers", a, n, d) - value,
            ),
        ),
    ),
    Exercise(
        "ex-06-3",
        path_cases,
        shortest,
        (
            Mistake(
                "you return the end of the path. The best mixture may lie anywhere on it: keep the shortest",
                lambda s, m, settle: with_length(s, path(s, m, settle)[-1]),
            ),
            Mistake(
                "you took out the strongest component; the weakest, weights.argmin(), has to go",
                lambda s, m, settle: with_length(
                    s, min(path(s, m, settle, np.argmax), key=lambda each: description_length(each, s))
                ),
            ),
            Mistake(
                "you chose by the log-likelihood, which always wants the most components. Compare description lengths",
                lambda s, m, settle: with_length(s, max(path(s, m, settle), key=lambda each: each.log_likelihood(s))),
            ),
            Mistake(
                "you stopped when the length rose for the first time. It may fall again: go down to one, then choose",
                at_first_rise,
            ),
            Mistake(
                "you counted the removals; `settle` may drop components, too, so ask the mixture: n_components",
                counted_down,
            ),
            Mistake(
                "EM has to run after each removal: call settle again, so that the others take over the points",
                unsettled,
            ),
        ),
    ),
)
