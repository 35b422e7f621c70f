"""Each equation of the paper, put right where it is misprinted, written as loops and held against the package.

The index of equations in the book is made from the names of these tests; the last test fails where an equation is
not named by a function, not taught in a chapter, or not tested.
"""

import sys
from itertools import pairwise, product
from math import exp, log, pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from gmmcd_teach import (
    GaussianMixture,
    confusion,
    description_length,
    emd,
    extract_changes,
    fit_mixture,
    mean_distances,
)
from gmmcd_teach.batch import expect, maximise, modified_weights
from gmmcd_teach.features import blocks_of, quadratic_features
from gmmcd_teach.mdl import mdl_penalty, n_parameters

K, D, N = 3, 2, 40
RNG = np.random.default_rng(5)
S = RNG.normal(size=(N, D))
ALPHA = np.array([0.5, 0.3, 0.2])
MU = RNG.normal(size=(K, D))
SIGMA = np.array([np.eye(D) * 0.3 + 0.4 * np.outer(v, v) for v in RNG.normal(size=(K, D))])
THETA = GaussianMixture(ALPHA, MU, SIGMA)
W = np.empty((N, K))  # responsibilities, filled by the literal Eq. 7


def gaussian(s, mu, sigma):
    """p(s | theta), two-dimensional, with the inverse and the determinant written out."""
    (a, b), (c, d) = sigma
    det = a * d - b * c
    x, y = s - mu
    return exp(-0.5 * (d * x * x - (b + c) * x * y + a * y * y) / det) / (2 * pi * sqrt(det))


def density(s):
    """p(s | Theta)."""
    return sum(ALPHA[k] * gaussian(s, MU[k], SIGMA[k]) for k in range(K))


for i, k in product(range(N), range(K)):
    W[i, k] = ALPHA[k] * gaussian(S[i], MU[k], SIGMA[k]) / density(S[i])


def one_step(min_components, covariance_floor=0.0, mixture=THETA):
    blocks = blocks_of(quadratic_features(S), np.ones(N))
    return maximise(mixture, expect(mixture, blocks)[1], blocks, min_components, covariance_floor)


def test_eq_01_density_of_a_mixture_is_the_weighted_sum():
    np.testing.assert_allclose(np.exp(THETA.log_density(S)), [density(s) for s in S], rtol=1e-12)


def test_eq_02_weights_are_not_negative_and_sum_to_one():
    for weights in ([0.5, 0.6, 0.2], [1.2, -0.2, 0.0]):
        with pytest.raises(ValueError, match="weights"):
            GaussianMixture(weights, MU, SIGMA)
    assert abs(fit_mixture(S, K).mixture.weights.sum() - 1) < 1e-12


def test_eq_03_07_responsibilities_by_bayes():
    np.testing.assert_allclose(THETA.responsibilities(S), W, rtol=1e-12)


def test_eq_04_log_likelihood_is_a_sum_of_logarithms():
    assert THETA.log_likelihood(S) == pytest.approx(sum(log(density(s)) for s in S), rel=1e-12)


def test_eq_05_em_ends_higher_than_any_small_step_away():
    fit = fit_mixture(S, K, K, tol=0, max_iter=600, covariance_floor=0.0)
    for axis, step in product(range(D), (-1e-3, 1e-3)):
        for k in range(K):
            means = fit.mixture.means.copy()
            means[k, axis] += step
            moved = GaussianMixture(fit.mixture.weights, means, fit.mixture.covariances)
            assert moved.log_likelihood(S) < fit.log_likelihood


def complete_log_likelihood(mixture):
    """Q of Eq. 6: sum over i, k of w_ik log(alpha_k p(s_i | theta_k)), with w_ik of the mixture before."""
    return sum(
        W[i, k] * log(mixture.weights[k] * gaussian(S[i], mixture.means[k], mixture.covariances[k]))
        for i, k in product(range(N), range(K))
    )


def test_eq_06_08_the_m_step_is_the_maximum_of_the_expected_log_likelihood():
    best = one_step(K)
    rng = np.random.default_rng(0)
    for _ in range(20):
        weights = best.weights * np.exp(0.01 * rng.normal(size=K))
        means = best.means + 0.01 * rng.normal(size=(K, D))
        covariances = best.covariances * np.exp(0.01 * rng.normal(size=(K, 1, 1)))
        other = GaussianMixture(weights / weights.sum(), means, covariances)
        assert complete_log_likelihood(other) < complete_log_likelihood(best)


def test_eq_09_10_means_and_covariances_are_weighted_moments():
    step = one_step(K)
    for k in range(K):
        total = sum(W[i, k] for i in range(N))
        mean = sum(W[i, k] * S[i] for i in range(N)) / total
        covariance = sum(W[i, k] * np.outer(S[i] - mean, S[i] - mean) for i in range(N)) / total
        np.testing.assert_allclose(step.means[k], mean, rtol=1e-10)
        np.testing.assert_allclose(step.covariances[k], covariance, rtol=1e-9)


def test_eq_11_weights_lose_half_the_parameters():
    p = n_parameters(D)
    support = [sum(W[i, k] for i in range(N)) for k in range(K)]
    kept = [max(0.0, n - p / 2) for n in support]
    np.testing.assert_allclose(one_step(1).weights, [a / sum(kept) for a in kept], rtol=1e-10)


def test_eq_12_only_components_with_weight_go_on():
    weak = GaussianMixture([0.97, 0.02, 0.01], MU, SIGMA)
    p = n_parameters(D)
    support = weak.responsibilities(S).sum(axis=0)
    assert (support < p / 2).any()
    step = one_step(1, mixture=weak)
    assert step.n_components == (support > p / 2).sum()
    assert (modified_weights(support, p / 2, 1) > 0).sum() == step.n_components


@pytest.mark.parametrize(("d", "p"), [(1, 2), (2, 5), (3, 9)])
def test_eq_13_parameters_of_one_component(d, p):
    entries = d + sum(1 for i in range(d) for j in range(d) if i <= j)
    assert n_parameters(d) == entries == p
    assert isinstance(n_parameters(d), int)


def test_eq_14_em_stops_when_the_likelihood_stands_still():
    tol = 1e-4
    likelihoods = [record.log_likelihood for record in fit_mixture(S, K, K, tol=tol).history]
    change = [abs(b - a) / abs(b) for a, b in pairwise(likelihoods)]
    assert change[-1] < tol
    assert all(c >= tol for c in change[:-1])


def literal_penalty(n_points, weights):
    """Eq. 16 with log(N / 12) in its second term."""
    p, k = n_parameters(D), len(weights)
    total = 0.0
    for alpha in weights:
        total += log(n_points * alpha / 12)
    return p / 2 * total + k / 2 * log(n_points / 12) + k * (p + 1) / 2


def test_eq_15_17_description_length_is_penalty_minus_log_likelihood():
    expected = literal_penalty(N, ALPHA) - sum(log(density(s)) for s in S)
    assert description_length(THETA, S) == pytest.approx(expected, rel=1e-12)
    records = fit_mixture(S, 8).history
    assert fit_mixture(S, 8).description_length <= min(r.description_length for r in records if r.event == "removed")


def test_eq_16_penalty_and_what_the_misprint_would_add():
    assert mdl_penalty(ALPHA, N, D) == pytest.approx(literal_penalty(N, ALPHA), rel=1e-12)
    printed = literal_penalty(N, ALPHA) + K / 2 * (log(N / 2) - log(N / 12))
    assert printed - mdl_penalty(ALPHA, N, D) == pytest.approx(K * 0.5 * log(6))


def test_eq_18_19_work_over_flow_of_the_linear_programme():
    p, q, cost = np.array([0.5, 0.3]), np.array([0.2, 0.4, 0.1]), RNG.uniform(size=(2, 3))
    rows = np.zeros((5, 6))  # sum_j f_ij <= p_i, then sum_i f_ij <= q_j
    for i, j in product(range(2), range(3)):
        rows[i, 3 * i + j] = rows[2 + j, 3 * i + j] = 1
    flow = min(p.sum(), q.sum())
    work = linprog(cost.ravel(), rows, [*p, *q], np.ones((1, 6)), [flow]).fun
    assert emd(p, q, cost, mass="partial").distance == pytest.approx(work / flow, rel=1e-9)


PREDICTED = np.array([1, 1, 1, 0, 0, 0, 0, 1], dtype=bool)
ACTUAL = np.array([1, 1, 0, 1, 1, 0, 0, 1], dtype=bool)
TP, FP, FN, TN = (
    sum(1 for p, a in zip(PREDICTED, ACTUAL, strict=True) if (p, a) == answer)
    for answer in ((True, True), (True, False), (False, True), (False, False))
)


def test_eq_20_21_22_23_scores_from_counts():
    table = confusion(PREDICTED, ACTUAL)
    assert (table.tp, table.fp, table.fn, table.tn) == (TP, FP, FN, TN)
    assert table.accuracy == (TP + TN) / (TP + FN + TN + FP)
    assert table.precision == TP / (TP + FP)
    assert table.recall == TP / (TP + FN)
    assert table.f1 == pytest.approx(2 * TP / (2 * TP + FP + FN))


def literal_algorithm_1(before, after):
    """Algorithm 1 with P8 put right: compare with the pass before, choose among all, stop when none helps."""
    cost = mean_distances(before, after)
    theta, taken = list(range(after.n_components)), []
    e_lowest = emd(before.weights, after.weights, cost).distance
    while len(theta) > 1:
        best = None
        for k in theta:
            rest = [j for j in theta if j != k]
            e_new = emd(before.weights, after.weights[rest], cost[:, rest]).distance
            if e_new < e_lowest - 1e-12:
                e_lowest, best = e_new, k
        if best is None:
            break
        theta.remove(best)
        taken.append(best)
    return taken


@pytest.mark.parametrize("seed", range(5))
def test_algorithm_1_greedy_extraction(seed):
    rng = np.random.default_rng(seed)
    before, after = (
        GaussianMixture(rng.dirichlet(np.ones(k)), rng.normal(size=(k, 3)), np.tile(np.eye(3), (k, 1, 1)))
        for k in (7, 9)
    )
    assert extract_changes(before, after).indices.tolist() == literal_algorithm_1(before, after)


def test_no_equation_is_an_orphan():
    root = Path(__file__).parents[1]
    sys.path.insert(0, str(root / "book" / "_ext"))
    try:
        from equations import index, mentioned
    finally:
        sys.path.pop(0)
    assert mentioned("Eqs. 2, 4 and 9 to 11; Eq. 20") == {"2", "4", "9", "10", "11", "20"}
    for equation, places in index(root).items():
        for what in ("functions", "chapters", "tests"):
            assert getattr(places, what), f"{equation}: {what} do not name it"
