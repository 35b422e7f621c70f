"""The checks of the exercises are checked: solution, stub and every planted mistake."""

import re
from itertools import cycle

import numpy as np
import pytest

from gmmcd_teach.exercises import EXERCISES, check, judge
from gmmcd_teach.exercises.checking import Exercise, _load_all, difference

_load_all()
ALL = sorted(EXERCISES)


@pytest.mark.parametrize("name", ALL)
def test_the_solution_passes(name):
    verdict = check(name, EXERCISES[name].solution)
    assert verdict.passed, verdict


@pytest.mark.parametrize("name", ALL)
def test_the_stub_is_told_that_it_is_not_done(name):
    verdict = check(name, lambda *arguments: ...)
    assert not verdict.passed
    assert not verdict.begun
    assert "not done yet" in verdict.says


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL)
def test_at_least_three_mistakes_are_recognised_and_named(name):
    mistakes = EXERCISES[name].mistakes
    assert len(mistakes) >= 3
    for mistake in mistakes:
        verdict = check(name, mistake.function)
        assert not verdict.passed
        assert verdict.says == mistake.says
    assert len({mistake.says for mistake in mistakes}) == len(mistakes)


def test_an_unknown_exercise_is_refused_with_those_of_the_chapter():
    with pytest.raises(ValueError, match=r"no exercise 'ex-01-9'; expected one of ex-01-1"):
        check("ex-01-9", len)


EXAMPLE = Exercise("example", lambda: [(np.arange(4.0),)], lambda x: 2 * x, ())


@pytest.mark.parametrize(
    ("attempt", "says"),
    [
        (lambda x: x[:2], r"shape \(2,\); expected \(4,\)"),
        (lambda x: x / 0 * 0, "NaN"),
        (lambda x: 3 * x, "3 of 4 numbers differ; yours is 3 at 1, expected 2"),
        (lambda x: ["a"] * 4, "expected numbers"),
        (lambda x: set(x), r"of type set; expected an array of shape \(4,\)"),
        (lambda x: {"answer": 2 * x}, "of type dict"),
        (lambda x: (2 * each for each in x), "of type generator"),
        (lambda x: -2 * x, "right up to the sign: yours is -2 at 1, expected 2"),
        (lambda x: np.float32(2.1) * x / np.float32(1.05) + 1e-6, "right to about five digits"),
        (lambda x: 1 / 0, "raised ZeroDivisionError"),
        (lambda x: x.sort() or np.multiply(x, 2, out=x), "in place"),
        (3, "pass your function itself"),
    ],
)
def test_what_is_not_a_usual_mistake_is_described(attempt, says):
    with np.errstate(all="ignore"):
        verdict = judge(EXAMPLE, attempt)
    assert not verdict.passed
    assert re.search(says, verdict.says), verdict.says


def test_parts_of_a_tuple_are_compared_one_by_one():
    assert difference((1.0, 2.0), (1.0, 3.0), 1e-8).startswith("part 2")
    assert "returns one thing, of type float; expected 2 things" in difference(1.0, (1.0, 3.0), 1e-8)
    assert "returns 3 things; expected 2" in difference((1.0, 2.0, 3.0), (1.0, 3.0), 1e-8)
    assert difference([1.0, 3.0], (1.0, 3.0), 1e-8) == ""
    assert "bool" in difference(np.ones(2), np.ones(2, bool), 1e-8)


def test_bools_are_shown_as_bools():
    assert difference(np.array([True, False]), np.array([True, True]), 1e-8) == (
        "1 of 2 answers differ; yours is False at 1, expected True"
    )


def test_the_entry_shown_is_one_that_looks_different():
    assert "yours is 3 at 1, expected 2" in difference([1.0000001, 3.0], np.array([1.0, 2.0]), 1e-8)


def test_an_axis_without_a_rule_for_its_sign_is_told_so():
    solution, turn = EXERCISES["ex-03-2"].solution, cycle([1, -1])
    assert "right up to the sign" in check("ex-03-2", lambda points: next(turn) * solution(points)).says


def test_finding_no_object_is_not_called_a_mistake_that_was_not_made():
    verdict = check("ex-09-3", lambda claimed, objects: np.zeros(objects.max(), dtype=bool))
    assert verdict.begun
    assert "expected True" in verdict.says
