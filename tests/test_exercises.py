"""The checks of the exercises are checked: solution, stub and every planted mistake."""

import re

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
    assert "expected 2 things" in difference(1.0, (1.0, 3.0), 1e-8)
    assert difference([1.0, 3.0], (1.0, 3.0), 1e-8) == ""
    assert "bool" in difference(np.ones(2), np.ones(2, bool), 1e-8)
