"""The Earth Mover's Distance against published cases, other solvers, closed forms, and the laws of a metric."""

from __future__ import annotations

import json
import sys

import numpy as np
import ot
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import sqrtm
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.stats import wasserstein_distance

from gmmcd_teach import CloudError, GaussianMixture, bures_distances, emd, mean_distances
from gmmcd_teach.extraction import removal_bounds

SEEDS = st.integers(0, 2**32 - 1)
SOLVERS = ("network-simplex", "linprog")
both_solvers = pytest.mark.parametrize("solver", SOLVERS)
quick = settings(max_examples=30, deadline=None)


def random_problem(seed: int, unequal: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses (K,) and (L,), some of them 0, and the distances of random places (K, L)."""
    rng = np.random.default_rng(seed)
    k, n = rng.integers(1, 9, 2)
    p, q = (rng.dirichlet(np.ones(size)) * (rng.random(size) < 0.8) for size in (k, n))
    p[rng.integers(k)] += 0.2
    q[rng.integers(n)] += 0.2
    p, q = p / p.sum(), q / q.sum()
    if unequal:
        p, q = p * rng.uniform(0.2, 3), q * rng.uniform(0.2, 3)
    return p, q, cdist(rng.uniform(-2, 2, (k, 3)), rng.uniform(-2, 2, (n, 3)))


def random_mixture(rng: np.random.Generator, k: int, d: int = 3) -> GaussianMixture:
    roots = rng.normal(size=(k, d, d))
    covariances = roots @ roots.swapaxes(1, 2) / 10 + 1e-3 * np.eye(d)
    return GaussianMixture(rng.dirichlet(np.ones(k)), rng.uniform(-2, 2, (k, d)), covariances)


@both_solvers
def test_published_cases(shared, solver):
    cases = {case["id"]: case for case in json.loads((shared / "reference/emd_cases.json").read_text("utf-8"))}
    assert len(cases) == 3
    for case in cases.values():
        p, q = np.array(case["supply"]), np.array(case["demand"])
        transport = emd(p, q, case["cost"], mass="partial", solver=solver)
        work = transport.distance * min(p.sum(), q.sum())
        expected = work if case["quantity"].startswith("TOTAL") else transport.distance
        assert expected == pytest.approx(case["expected"], rel=1e-6)
        assert transport.distance == pytest.approx(case["recomputed_normalised"], rel=1e-8)
        assert work == pytest.approx(case["recomputed_total_cost"], rel=1e-8)


@given(SEEDS, st.booleans(), st.sampled_from(["normalized", "partial"]))
@quick
def test_both_solvers_find_the_same_distance_and_flows_that_keep_to_the_masses(seed, unequal, mass):
    p, q, cost = random_problem(seed, unequal)
    answers = [emd(p, q, cost, mass=mass, solver=solver) for solver in SOLVERS]
    assert answers[0].distance == pytest.approx(answers[1].distance, rel=1e-9, abs=1e-9)
    if mass == "normalized":
        p, q = p / p.sum(), q / q.sum()
    for transport in answers:
        flow = transport.flow
        assert flow.shape == cost.shape
        assert (flow >= 0).all()
        assert (flow.sum(axis=1) <= p + 1e-12).all()
        assert (flow.sum(axis=0) <= q + 1e-12).all()
        assert flow.sum() == pytest.approx(min(p.sum(), q.sum()), rel=1e-12)
        assert transport.distance == pytest.approx((flow * cost).sum() / flow.sum(), rel=1e-12, abs=1e-15)


@given(SEEDS)
@quick
def test_partial_masses_as_pots_partial_transport_has_it(seed):
    p, q, cost = random_problem(seed, unequal=True)
    moved = min(p.sum(), q.sum()) * (1 - 1e-12)
    work = (ot.partial.partial_wasserstein(p, q, cost, m=moved) * cost).sum()
    assert emd(p, q, cost, mass="partial").distance == pytest.approx(work / moved, rel=1e-9, abs=1e-9)


@given(SEEDS)
@quick
def test_on_a_line_it_is_the_area_between_the_distribution_functions(seed):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=5), rng.normal(size=7)
    p, q = rng.dirichlet(np.ones(5)), 3 * rng.dirichlet(np.ones(7))
    expected = wasserstein_distance(x, y, p, q)
    assert emd(p, q, abs(x[:, None] - y)).distance == pytest.approx(expected, rel=1e-12)


@given(SEEDS)
@quick
def test_of_equal_single_masses_it_is_the_best_assignment(seed):
    cost = np.random.default_rng(seed).random((6, 6))
    rows, columns = linear_sum_assignment(cost)
    assert emd(np.ones(6), np.ones(6), cost).distance == pytest.approx(cost[rows, columns].mean(), rel=1e-12)


@given(SEEDS)
@quick
def test_with_equal_masses_it_is_a_metric_bounded_below_by_the_distance_of_the_means(seed):
    rng = np.random.default_rng(seed)
    a, b, c = (random_mixture(rng, k) for k in rng.integers(1, 8, 3))

    def between(p: GaussianMixture, q: GaussianMixture) -> float:
        return emd(p.weights, q.weights, mean_distances(p, q)).distance

    assert between(a, b) == pytest.approx(between(b, a), rel=1e-12)
    assert between(a, a) <= 1e-15
    assert between(a, c) <= between(a, b) + between(b, c) + 1e-12
    assert between(a, b) >= np.linalg.norm(a.weights @ a.means - b.weights @ b.means) - 1e-12


def test_partial_matching_is_no_metric():
    """A mass inside both of two others that have nothing in common (erratum P7)."""
    places = np.array([[0.0], [5.0]])
    left, right, both = np.array([1.0, 0.0]), np.array([0.0, 1.0]), np.array([1.0, 1.0])
    d = cdist(places, places)

    def between(p: np.ndarray, q: np.ndarray) -> float:
        return emd(p, q, d, mass="partial").distance

    assert between(left, both) == between(both, right) == 0.0
    assert between(left, right) == 5.0


@given(SEEDS, st.floats(-9, 9), st.floats(-9, 9))
@example(0, 0.0, -9.0)
@example(1, 0.0, -9.0)
@quick
def test_units_of_distance_and_mass_do_not_matter(seed, distance, mass):
    p, q, cost = random_problem(seed, unequal=True)
    for solver in SOLVERS:
        for kind in ("normalized", "partial"):
            here = emd(p, q, cost, mass=kind, solver=solver).distance
            there = emd(10**mass * p, 10**mass * q, 10**distance * cost, mass=kind, solver=solver).distance
            assert there == pytest.approx(10**distance * here, rel=1e-9, abs=1e-12 * 10**distance)


@given(SEEDS)
@quick
def test_the_order_of_the_masses_does_not_matter(seed):
    p, q, cost = random_problem(seed)
    rng = np.random.default_rng(seed)
    rows, columns = rng.permutation(len(p)), rng.permutation(len(q))
    shuffled = emd(p[rows], q[columns], cost[rows][:, columns]).distance
    assert shuffled == pytest.approx(emd(p, q, cost).distance, rel=1e-12, abs=1e-15)


@given(SEEDS, st.sampled_from(SOLVERS))
@quick
def test_the_prices_are_dual_to_the_flow(seed, solver):
    """With u_k = min_l (c_kl - v_l), what the sources and targets pay together is the whole distance."""
    p, q, cost = random_problem(seed)
    transport = emd(p, q, cost, solver=solver)
    u = (cost - transport.prices).min(axis=1)
    assert u @ p + transport.prices @ q == pytest.approx(transport.distance, rel=1e-9, abs=1e-12)


@given(SEEDS)
@quick
def test_no_removal_undercuts_its_bound(seed):
    p, q, cost = random_problem(seed)
    bounds = removal_bounds(q, emd(p, q, cost))
    for k in range(len(q)):
        if np.delete(q, k).sum() > 0:
            assert emd(p, np.delete(q, k), np.delete(cost, k, axis=1)).distance >= bounds[k] - 1e-12


@given(SEEDS)
@quick
def test_ground_distances_against_loops(seed):
    rng = np.random.default_rng(seed)
    d = int(rng.integers(1, 4))
    p, q = random_mixture(rng, 3, d), random_mixture(rng, 4, d)
    means, bures = mean_distances(p, q), bures_distances(p, q)
    assert means.shape == bures.shape == (3, 4)
    for i in range(3):
        for j in range(4):
            assert means[i, j] == pytest.approx(np.linalg.norm(p.means[i] - q.means[j]), rel=1e-12)
            a, b = p.covariances[i], q.covariances[j]
            cross = np.real(np.trace(sqrtm(sqrtm(a) @ b @ sqrtm(a))))
            squared = means[i, j] ** 2 + np.trace(a) + np.trace(b) - 2 * cross
            assert bures[i, j] == pytest.approx(np.sqrt(squared), rel=1e-6)
    np.testing.assert_allclose(bures_distances(q, p), bures.T, rtol=1e-6)


def test_bures_is_zero_for_equal_gaussians_as_far_as_a_root_of_a_difference_can_be():
    p = random_mixture(np.random.default_rng(0), 8)
    trace = np.trace(p.covariances, axis1=1, axis2=2)
    assert (np.diagonal(bures_distances(p, p)) <= np.sqrt(256 * np.finfo(float).eps * trace)).all()


def test_bures_of_a_needle_and_a_plate_is_finite():
    flat = [np.diag([1.0, 1e-18, 1e-18]), np.diag([1.0, 1.0, 1e-18])]
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    for covariance in flat:
        tilted = turn @ covariance @ turn.T + 1e-16 * np.eye(3)
        p = GaussianMixture([1.0], [[0.0, 0.0, 0.0]], [(tilted + tilted.T) / 2])
        assert np.isfinite(bures_distances(p, p)).all()


ARGUMENTS = {"weights_p": [0.5, 0.5], "weights_q": [1.0], "ground_distance": [[1.0], [2.0]]}


@pytest.mark.parametrize("name", ["weights_p", "weights_q"])
@pytest.mark.parametrize(
    "wrong", [[], [-0.5, 1.5], [np.nan, 1.0], [np.inf, 1.0], [0.0, 0.0], [[1.0]], 1.0, ["a"], None]
)
def test_masses_that_are_none_are_refused(name, wrong):
    with pytest.raises(CloudError, match=f"{name}: "):
        emd(**{**ARGUMENTS, name: wrong})


@pytest.mark.parametrize(
    "wrong", [[[1.0, 2.0]], [1.0, 2.0], [[-1.0], [2.0]], [[np.nan], [2.0]], [[np.inf], [2.0]], "far"]
)
def test_ground_distances_that_are_none_are_refused(wrong):
    with pytest.raises(CloudError, match="ground_distance: "):
        emd(**{**ARGUMENTS, "ground_distance": wrong})


@pytest.mark.parametrize(
    ("option", "allowed"), [("mass", "'normalized', 'partial'"), ("solver", "'network-simplex', ")]
)
def test_an_unknown_option_is_refused_with_those_allowed(option, allowed):
    with pytest.raises(ValueError, match=f"{option} = 'sinkhorn'; expected one of {allowed}"):
        emd(**ARGUMENTS, **{option: "sinkhorn"})


@pytest.mark.parametrize("ground", [mean_distances, bures_distances])
def test_mixtures_of_different_dimension_have_no_distance(ground):
    rng = np.random.default_rng(0)
    with pytest.raises(CloudError, match="mixtures of 2 and 3 dimensions"):
        ground(random_mixture(rng, 2, 2), random_mixture(rng, 2, 3))


def test_a_solver_that_gives_up_is_not_believed(monkeypatch):
    """The published code takes whatever comes back (erratum C9)."""
    solved = ot.emd
    monkeypatch.setattr(ot, "emd", lambda *a, **k: (solved(*a, **k)[0], {"warning": "gave up", "u": np.zeros(2)}))
    with pytest.raises(RuntimeError, match="network simplex found no optimal flow: gave up"):
        emd(**ARGUMENTS)
    for best in (None, np.zeros(2)):
        failed = type("Failed", (), {"success": False, "x": best, "message": "infeasible"})
        monkeypatch.setattr(sys.modules["gmmcd_teach.emd"], "linprog", lambda *a, failed=failed, **k: failed)
        with pytest.raises(RuntimeError, match="linprog found no optimal flow: infeasible"):
            emd(**ARGUMENTS, solver="linprog")


@pytest.mark.parametrize("solver", ["network-simplex", "linprog"])
def test_masses_that_no_solver_can_tell_from_nothing_are_refused(solver):
    with pytest.raises(CloudError, match=r"^masses of 1 and 1e-18: too unequal for a solver; scale them alike$"):
        emd([1.0], [1e-18], [[2.0]], mass="partial", solver=solver)
    with pytest.raises(CloudError, match=r"^weights_p: expected a .* masses from 0 to 1e150"):
        emd([1e308, 1e308], [1.0], [[2.0], [1.0]], solver=solver)


def test_what_is_no_mixture_is_named():
    one = GaussianMixture([1.0], [[0.0]], [[[1.0]]])
    with pytest.raises(CloudError, match=r"^p: NoneType; expected a GaussianMixture$"):
        mean_distances(None, one)
    with pytest.raises(CloudError, match=r"^q: int; expected a GaussianMixture$"):
        mean_distances(one, 3)
