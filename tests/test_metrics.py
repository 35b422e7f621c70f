"""Counts and scores against scikit-learn, and the truth of components against a loop."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn import metrics

from gmmcd_teach import CloudError, Confusion, GaussianMixture, component_truth, confusion

SEEDS = st.integers(0, 2**32 - 1)
ANSWERS = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=30)
PAIR = GaussianMixture([0.5, 0.5], [[0.0], [9.0]], [[[1.0]], [[1.0]]])
quick = settings(max_examples=40, deadline=None)


@given(ANSWERS)
@quick
def test_counts_and_scores_are_scikit_learns(answers):
    predicted, actual = np.array(answers).T
    table = confusion(predicted, actual)
    tn, fp, fn, tp = metrics.confusion_matrix(actual, predicted, labels=[False, True]).ravel()
    assert (table.tp, table.fp, table.fn, table.tn) == (tp, fp, fn, tn)
    same = {"rel": 1e-15, "nan_ok": True}
    assert table.accuracy == pytest.approx(metrics.accuracy_score(actual, predicted), **same)
    score = {"zero_division": np.nan}
    assert table.precision == pytest.approx(metrics.precision_score(actual, predicted, **score), **same)
    assert table.recall == pytest.approx(metrics.recall_score(actual, predicted, **score), **same)
    assert table.f1 == pytest.approx(metrics.f1_score(actual, predicted, zero_division=1.0), **same)


@given(ANSWERS, st.randoms(use_true_random=False))
@quick
def test_order_does_not_matter_and_claim_and_truth_change_places(answers, random):
    shuffled = random.sample(answers, len(answers))
    predicted, actual = np.array(answers).T
    table = confusion(predicted, actual)
    assert confusion(*np.array(shuffled).T) == table
    swapped = confusion(actual, predicted)
    assert (swapped.tp, swapped.fp, swapped.fn, swapped.tn) == (table.tp, table.fn, table.fp, table.tn)
    assert swapped.precision == pytest.approx(table.recall, nan_ok=True)
    assert swapped.f1 == table.f1
    if table.tp:
        assert table.f1 == pytest.approx(2 / (1 / table.precision + 1 / table.recall), rel=1e-15)


def test_a_question_that_was_not_asked_has_no_answer():
    quiet = Confusion(tp=0, fp=0, fn=0, tn=5)
    assert math.isnan(quiet.precision)
    assert math.isnan(quiet.recall)
    assert (quiet.f1, quiet.accuracy) == (1.0, 1.0)
    assert Confusion(0, 3, 0, 0).f1 == Confusion(0, 0, 3, 0).f1 == 0.0
    assert math.isnan(confusion(np.zeros(0, bool), np.zeros(0, bool)).accuracy)


@given(SEEDS, st.sampled_from([0.0, 0.25, 0.5, 0.9, 1.0]))
@quick
def test_the_truth_of_components_against_a_loop(seed, threshold):
    rng = np.random.default_rng(seed)
    m = GaussianMixture(rng.dirichlet(np.ones(5)), rng.uniform(-3, 3, (5, 2)), [np.eye(2)] * 5)
    points, changed = rng.uniform(-4, 4, (40, 2)), rng.random(40) < 0.5
    owner = m.responsibilities(points).argmax(axis=1)
    expected = []
    for k in range(5):
        mine = [bool(changed[i]) for i in range(40) if owner[i] == k]
        expected.append(bool(mine) and sum(mine) > threshold * len(mine))
    np.testing.assert_array_equal(component_truth(m, points, changed, threshold), expected)


def test_half_is_not_more_than_half_and_no_point_is_no_change():
    np.testing.assert_array_equal(component_truth(PAIR, [[0.0], [0.1]], [True, False]), [False, False])
    np.testing.assert_array_equal(component_truth(PAIR, [[0.0], [0.1]], [True, True]), [True, False])
    np.testing.assert_array_equal(component_truth(PAIR, [[0.0]], [True], threshold=1.0), [False, False])


@pytest.mark.parametrize("wrong", [[1, 0], [0.2, 0.9], ["yes", "no"], [[True, False]], True, None])
@pytest.mark.parametrize("name", ["predicted", "actual"])
def test_answers_that_are_not_yes_or_no_are_refused(name, wrong):
    with pytest.raises(CloudError, match=rf"{name}: .*expected bool of shape \(N,\)"):
        confusion(**{"predicted": [True, False], "actual": [True, False], name: wrong})


def test_answers_to_different_questions_are_refused():
    with pytest.raises(CloudError, match="predicted, actual: 2 and 1 answers"):
        confusion([True, False], [True])
    with pytest.raises(CloudError, match="changed: 1 flags for 2 points"):
        component_truth(PAIR, [[0.0], [9.0]], [True])
    with pytest.raises(CloudError, match="changed: int64 of shape"):
        component_truth(PAIR, [[0.0], [9.0]], np.array([0, 1], dtype=np.int64))


@pytest.mark.parametrize("threshold", [-0.1, 1.1, np.nan])
def test_a_threshold_outside_0_to_1_is_refused(threshold):
    with pytest.raises(ValueError, match=f"threshold = {threshold}; expected 0 to 1"):
        component_truth(PAIR, [[0.0]], [True], threshold)
