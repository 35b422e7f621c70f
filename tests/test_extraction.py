"""Greedy extraction: what was changed is taken, wherever it stands in the list, and nothing else."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gmmcd_teach import (
    CloudError,
    GaussianMixture,
    description_length,
    emd,
    extract_changes,
    fit_mixture,
    mean_distances,
)
from gmmcd_teach.extraction import best_removal, removal_bounds

SEEDS = st.integers(0, 2**32 - 1)
POSITIONS = range(20)
quick = settings(max_examples=25, deadline=None)
GROUND = pytest.mark.parametrize("ground", ["means", "bures"])


def random_mixture(rng: np.random.Generator, k: int) -> GaussianMixture:
    roots = rng.normal(size=(k, 3, 3))
    covariances = roots @ roots.swapaxes(1, 2) / 100 + 1e-4 * np.eye(3)
    return GaussianMixture(rng.dirichlet(np.full(k, 3.0)), rng.uniform(-2, 2, (k, 3)), covariances)


def literal_extraction(before: GaussianMixture, after: GaussianMixture, mass: str) -> tuple[list[int], list[float]]:
    """Algorithm 1 with P8, C1 and C2 put right, by the other solver, every candidate tried."""

    def distance(kept: list[int]) -> float:
        q = after.weights[kept]
        q = q / q.sum() if mass == "normalized" else q
        cost = mean_distances(before, after)[:, kept]
        return emd(before.weights, q, cost, mass=mass, solver="linprog").distance

    kept, taken = list(range(after.n_components)), []
    distances = [distance(kept)]
    while len(kept) > 1:
        trials = [distance([j for j in kept if j != k]) for k in kept]
        if min(trials) >= distances[-1] - 1e-9:
            break
        taken.append(kept.pop(int(np.argmin(trials))))
        distances.append(min(trials))
    return taken, distances


@given(SEEDS, st.sampled_from(["normalized", "partial"]))
@quick
def test_the_same_as_trying_every_removal(seed, mass):
    rng = np.random.default_rng(seed)
    before, after = random_mixture(rng, int(rng.integers(1, 6))), random_mixture(rng, int(rng.integers(1, 7)))
    taken, distances = literal_extraction(before, after, mass)
    extraction = extract_changes(before, after, mass=mass)
    np.testing.assert_array_equal(extraction.indices, taken)
    np.testing.assert_allclose(extraction.distances, distances, rtol=1e-8, atol=1e-10)


def room_and_object(position: int, place: float) -> GaussianMixture:
    """Twenty equal Gaussians: nineteen in a room of 4 m, and one at `place` along x, at `position` in the list."""
    room = random_mixture(np.random.default_rng(position), 20)
    means = room.means.copy()
    means[position] = [place, 0.0, 0.0]
    return GaussianMixture(np.full(20, 1 / 20), means, room.covariances)


@GROUND
@pytest.mark.parametrize("position", POSITIONS)
@pytest.mark.parametrize("place", [0.5, 6.0], ids=["inside", "outside"])
def test_one_added_is_taken_and_for_one_removed_nothing_is(place, position, ground):
    """Without the added one both are the same mixture, so its removal brings the EMD to 0."""
    after = room_and_object(position, place)
    before = after.subset(np.delete(np.arange(20), position))
    added = extract_changes(before, after, ground=ground)
    np.testing.assert_array_equal(added.indices, [position])
    rounding = np.sqrt(1e-14) if ground == "bures" else 1e-14  # a Bures distance is the root of a difference
    assert added.distances[0] > 1e-3 > rounding > added.distances[1]
    assert extract_changes(after, before, ground=ground).indices.size == 0


@GROUND
@pytest.mark.parametrize("position", POSITIONS)
def test_one_moved_is_taken_at_its_new_place_and_at_its_old_one(position, ground):
    """Its mass has a longer way to its other place than to the others, so its removal pays."""
    west, east = room_and_object(position, -6.0), room_and_object(position, 6.0)
    for before, after in ((west, east), (east, west)):
        np.testing.assert_array_equal(extract_changes(before, after, ground=ground).indices, [position])


@given(SEEDS, st.floats(0.1, 20))
@quick
def test_a_move_pays_where_the_others_are_nearer_than_the_other_place(seed, distance):
    """What greedy extraction can know of a moved Gaussian, on either side: the work before and after its removal."""
    rng = np.random.default_rng(seed)
    k, direction = int(rng.integers(20)), rng.normal(size=3)
    before = room_and_object(k, rng.uniform(-2, 2))
    means = before.means.copy()
    means[k] += distance * direction / np.linalg.norm(direction)
    after = GaussianMixture(before.weights, means, before.covariances)
    for old, new in ((before, after), (after, before)):
        here = emd(old.weights, new.weights, mean_distances(old, new)).distance
        assert here <= distance / 20 + 1e-12
        rest = new.subset(np.delete(np.arange(20), k))
        there = emd(old.weights, rest.weights, mean_distances(old, rest)).distance
        assert there == pytest.approx(np.delete(mean_distances(old, new)[k], k).mean() / 20, rel=1e-9)
        if there < here - 1e-9:
            assert extract_changes(old, new).distances[1] <= there + 1e-12


def test_the_last_component_is_tried_and_every_pass_is_compared_with_the_one_before():
    """Both faults of the published loop, C1 and C2, on one example each."""
    fixed = random_mixture(np.random.default_rng(0), 20)
    more = GaussianMixture(
        np.append(0.8 * fixed.weights, [0.1, 0.1]),
        np.vstack([fixed.means, [[9.0, 9.0, 9.0], [-9.0, 9.0, 9.0]]]),
        np.concatenate([fixed.covariances, fixed.covariances[:2]]),
    )
    assert set(extract_changes(fixed, more).indices) == {20, 21}
    last = GaussianMixture(more.weights[:21] / more.weights[:21].sum(), more.means[:21], more.covariances[:21])
    np.testing.assert_array_equal(extract_changes(fixed, last).indices, [20])


@GROUND
@given(seed=SEEDS)
@quick
def test_identical_mixtures_have_not_changed_in_whatever_order(ground, seed):
    rng = np.random.default_rng(seed)
    m = random_mixture(rng, 12)
    extraction = extract_changes(m, m.subset(rng.permutation(12)), ground=ground)
    assert extraction.indices.size == 0
    assert extraction.distances.shape == (1,)


@given(SEEDS)
@quick
def test_each_removal_lowers_the_distance_and_one_component_stays(seed):
    rng = np.random.default_rng(seed)
    before, after = random_mixture(rng, 6), random_mixture(rng, 8)
    extraction = extract_changes(before, after)
    assert len(extraction.distances) == len(extraction.indices) + 1
    assert (np.diff(extraction.distances) < 0).all()
    assert len(set(extraction.indices)) == len(extraction.indices) < after.n_components
    kept = after.subset(np.setdiff1d(np.arange(8), extraction.indices))
    last = emd(before.weights, kept.weights, mean_distances(before, kept)).distance
    assert extraction.distances[-1] == pytest.approx(last, rel=1e-12)


@given(SEEDS)
@quick
def test_units_place_pose_and_order_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    before, after = random_mixture(rng, 7), random_mixture(rng, 9)
    turn, shift = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.uniform(-1000, 1000, 3)
    scale, order = 10.0 ** rng.uniform(-3, 3), rng.permutation(9)

    def there(m: GaussianMixture) -> GaussianMixture:
        covariances = scale**2 * turn @ m.covariances @ turn.T
        return GaussianMixture(m.weights, scale * m.means @ turn.T + shift, covariances)

    here = extract_changes(before, after)
    moved = extract_changes(there(before), there(after).subset(order))
    np.testing.assert_array_equal(order[moved.indices], here.indices)
    np.testing.assert_allclose(moved.distances / scale, here.distances, rtol=1e-6, atol=1e-12 * 1000 / scale)


def test_partial_masses_run_away():
    """P14: mass that is not there need not be moved, so every removal pays, until one component is left."""
    rng = np.random.default_rng(0)
    before = random_mixture(rng, 20)
    refitted = GaussianMixture(before.weights, before.means + rng.normal(0, 0.01, (20, 3)), before.covariances)
    assert len(extract_changes(before, refitted, mass="partial").indices) == 19
    assert extract_changes(before, refitted).indices.size == 0


def test_only_bures_sees_a_change_of_shape():
    before = random_mixture(np.random.default_rng(3), 20)
    covariances = before.covariances.copy()
    covariances[4] += 16 * np.eye(3)
    after = GaussianMixture(before.weights, before.means, covariances)
    assert extract_changes(before, after, ground="means").indices.size == 0
    np.testing.assert_array_equal(extract_changes(before, after, ground="bures").indices, [4])


def test_what_has_no_weight_is_neither_taken_nor_left_alone():
    m = random_mixture(np.random.default_rng(5), 3)
    far = GaussianMixture([1.0, 0.0, 0.0], m.means, m.covariances)
    assert extract_changes(m, far).indices.size == 0
    two = GaussianMixture([0.5, 0.5, 0.0], m.means, m.covariances)
    taken = extract_changes(m.subset([0]), two).indices
    np.testing.assert_array_equal(taken, [1])


def test_bounds_save_work_without_changing_the_answer(monkeypatch):
    rng = np.random.default_rng(6)
    before, after = random_mixture(rng, 20), random_mixture(rng, 21)
    cost = mean_distances(before, after)
    here = emd(before.weights, after.weights, cost)
    calls = []
    module = sys.modules["gmmcd_teach.extraction"]
    monkeypatch.setattr(module, "emd", lambda *a, **k: calls.append(1) or emd(*a, **k))
    best, there = best_removal(before.weights, after.weights, cost, here, "normalized")
    bounded = len(calls)
    monkeypatch.setattr(module, "removal_bounds", lambda q, here: np.full(len(q), -np.inf))
    every, same = best_removal(before.weights, after.weights, cost, here, "normalized")
    assert (best, there.distance) == (every, same.distance)
    assert bounded < 21 == len(calls) - bounded


@pytest.mark.parametrize("scale", [1e-3, 0.1, 10.0])
def test_bounds_and_choice_do_not_depend_on_what_the_weights_left_sum_to(scale):
    """After a removal they sum to less than 1."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        before, after = random_mixture(rng, 6), random_mixture(rng, 8)
        cost = mean_distances(before, after)
        here = emd(before.weights, after.weights, cost)
        best, there = best_removal(before.weights, after.weights, cost, here, "normalized")
        same, scaled = best_removal(before.weights, scale * after.weights, cost, here, "normalized")
        assert same == best
        assert scaled.distance == pytest.approx(there.distance, rel=1e-12)


@given(SEEDS)
@quick
def test_bounds_are_what_the_present_prices_ask_for_the_weights_left(seed):
    """Weak duality spelled out: u.p + v.q for q without k, u and v as they were; exact where there is one source."""
    rng = np.random.default_rng(seed)
    before, after = random_mixture(rng, int(rng.integers(1, 6))), random_mixture(rng, 7)
    p, q, cost = before.weights, after.weights, mean_distances(before, after)
    here = emd(p, q, cost)
    u = (cost - here.prices).min(axis=1)
    for k, bound in enumerate(removal_bounds(q, here)):
        rest = np.where(np.arange(7) == k, 0.0, q)
        assert bound == pytest.approx(u @ p + here.prices @ rest / rest.sum(), rel=1e-9)
        if len(p) == 1:
            assert bound == pytest.approx(emd(p, rest, cost).distance, rel=1e-9)


def test_of_removals_that_pay_the_same_the_first_is_taken():
    place = GaussianMixture([1.0], [[0.0]], [[[1.0]]])
    ring = GaussianMixture(np.full(30, 1 / 30), np.repeat([[2.0], [1.0]], [29, 1], axis=0), [[[1.0]]] * 30)
    taken = extract_changes(place, ring).indices
    np.testing.assert_array_equal(taken, np.arange(29))


@pytest.mark.parametrize("places", [[[0.0], [0.0]], [[-1.0], [1.0]]], ids=["both here", "both as far"])
def test_a_removal_that_changes_nothing_is_not_made(places):
    after = GaussianMixture([0.5, 0.5], places, [[[1.0]], [[2.0]]])
    taken = extract_changes(GaussianMixture([1.0], [[0.0]], [[[1.0]]]), after).indices
    assert taken.size == 0
    assert taken.dtype == np.intp


def test_a_single_component_cannot_be_taken():
    m = random_mixture(np.random.default_rng(7), 1)
    assert extract_changes(m, random_mixture(np.random.default_rng(8), 1)).indices.size == 0


@pytest.mark.parametrize(
    ("option", "allowed"), [("ground", "'means', 'bures'"), ("mass", "'normalized', 'partial'")], ids=str
)
def test_an_unknown_option_is_refused_with_those_allowed(option, allowed):
    m = random_mixture(np.random.default_rng(9), 2)
    with pytest.raises(ValueError, match=f"{option} = 'other'; expected one of {allowed}"):
        extract_changes(m, m, **{option: "other"})


def test_mixtures_of_different_dimension_cannot_be_compared():
    flat = GaussianMixture([1.0], [[0.0, 0.0]], [np.eye(2)])
    with pytest.raises(CloudError, match="mixtures of 2 and 3 dimensions"):
        extract_changes(flat, random_mixture(np.random.default_rng(0), 2))


def test_what_is_no_mixture_is_named():
    fit = fit_mixture(np.random.default_rng(0).normal(size=(100, 2)), 2)
    with pytest.raises(CloudError, match=r"^before: MixtureFit; expected a GaussianMixture, its \.mixture$"):
        extract_changes(fit, fit.mixture)
    with pytest.raises(CloudError, match=r"^after: list; expected a GaussianMixture$"):
        extract_changes(fit.mixture, [fit.mixture])
    with pytest.raises(CloudError, match=r"^q: MixtureFit; expected"):
        mean_distances(fit.mixture, fit)
    with pytest.raises(CloudError, match=r"^mixture: MixtureFit; expected"):
        description_length(fit, np.zeros((3, 2)))
