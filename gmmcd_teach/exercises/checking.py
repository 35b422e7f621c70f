"""How an attempt is judged: beside the solution, and beside the mistakes that students make.

An exercise knows its solution and, as functions too, the mistakes that are usual: the axis that was mixed up, the
weights that were forgotten. An attempt that gives what such a function gives has made that mistake.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Mistake:
    """A usual mistake: what to tell the student, and a function that makes it."""

    says: str
    function: Callable[..., Any]


@dataclass(frozen=True)
class Exercise:
    """A task with its solution.

    Attributes
    ----------
    name : the label of the exercise in the book, "ex-05-1" for the first one of chapter 5.
    cases : called without arguments, gives the tuples of arguments on which an attempt is tried.
    solution : the function that is right; it returns a number, an array, or a tuple of those.
    mistakes : the usual ones, at least three.
    tolerance : largest relative difference that still counts as equal.
    """

    name: str
    cases: Callable[[], Iterable[tuple[Any, ...]]]
    solution: Callable[..., Any]
    mistakes: tuple[Mistake, ...]
    tolerance: float = 1e-8


@dataclass(frozen=True)
class Verdict:
    """What a check found: is the attempt right, is it begun at all, and what there is to say."""

    name: str
    passed: bool
    begun: bool
    says: str

    def __repr__(self) -> str:
        return f"{'✓' if self.passed else '✗' if self.begun else '…'} {self.name}: {self.says}"


EXERCISES: dict[str, Exercise] = {}


def register(*exercises: Exercise) -> None:
    """Make exercises known to `check`; a name may be taken once."""
    for exercise in exercises:
        if exercise.name in EXERCISES:
            raise ValueError(f"exercise {exercise.name!r} is there already; choose another name")
        EXERCISES[exercise.name] = exercise


def check(name: str, attempt: Callable[..., Any]) -> Verdict:
    """Judge a student's function and say in words what is right or wrong with it.

    Parameters
    ----------
    name : label of the exercise, as "ex-05-1".
    attempt : the student's function.

    Raises
    ------
    ValueError
        There is no exercise of that name; the message lists those of the chapter.

    Examples
    --------
    >>> check("ex-01-1", lambda points: None)
    … ex-01-1: not done yet: your function returns None. Replace the dots, and let it return its answer.
    """
    _load_all()
    if name not in EXERCISES:
        near = sorted(known for known in EXERCISES if known[:5] == str(name)[:5]) or sorted(EXERCISES)
        raise ValueError(f"no exercise {name!r}; expected one of {', '.join(near)}")
    return judge(EXERCISES[name], attempt)


def judge(exercise: Exercise, attempt: Callable[..., Any]) -> Verdict:
    """Try an attempt on every case of an exercise; the first difference decides."""
    if not callable(attempt):
        return Verdict(exercise.name, False, True, f"pass your function itself, not {type(attempt).__name__}")
    cases = [tuple(case) for case in exercise.cases()]
    for number, case in enumerate(cases):
        untouched = [np.copy(a) if isinstance(a, np.ndarray) else a for a in case]
        try:
            answer = attempt(*case)
        except NotImplementedError:
            return Verdict(exercise.name, False, False, "not done yet")
        except Exception as error:  # whatever a student's code raises is told to the student
            return Verdict(exercise.name, False, True, f"your function raised {type(error).__name__}: {error}")
        if answer is None or answer is Ellipsis:
            nothing = "the dots" if answer is Ellipsis else "None"
            says = f"not done yet: your function returns {nothing}. Replace the dots, and let it return its answer."
            return Verdict(exercise.name, False, number > 0, says)
        if any(difference(a, b, 0.0) for a, b in zip(case, untouched, strict=True) if isinstance(a, np.ndarray)):
            return Verdict(exercise.name, False, True, "your function changed its input in place; work on a copy")
        trouble = difference(answer, exercise.solution(*untouched), exercise.tolerance)
        if trouble:
            named = recognised(exercise, attempt, cases[number:])
            return Verdict(exercise.name, False, True, named or trouble)
    return Verdict(exercise.name, True, True, f"right, on {len(cases)} case{'s' * (len(cases) > 1)}")


def recognised(exercise: Exercise, attempt: Callable[..., Any], cases: list[tuple[Any, ...]]) -> str:
    """What to say of the first usual mistake that gives the same answers as the attempt; "" where none does."""
    for mistake in exercise.mistakes:
        try:
            if all(not difference(attempt(*case), mistake.function(*case), exercise.tolerance) for case in cases):
                return mistake.says
        except Exception:  # the mistake, or the attempt, fails on this input: not the same mistake
            continue
    return ""


def difference(answer: Any, right: Any, tolerance: float) -> str:
    """How an answer differs from the right one, in one line; "" where it does not."""
    if isinstance(right, tuple):
        several = isinstance(answer, (tuple, list))
        if not several or len(answer) != len(right):
            found = f"{len(answer)} things" if several else f"one thing, of type {type(answer).__name__}"
            return f"your function returns {found}; expected {len(right)} things, separated by commas"
        parts = (difference(a, r, tolerance) for a, r in zip(answer, right, strict=True))
        return next((f"part {number + 1}: {says}" for number, says in enumerate(parts) if says), "")
    try:
        ours, wanted = np.asarray(answer), np.asarray(right)
    except ValueError:
        return "your function returns a ragged list; expected one array"
    if ours.ndim == 0 and ours.dtype.kind not in "biufc":  # a set, a dictionary, a string, a generator
        expected = f"an array of shape {wanted.shape}" if wanted.ndim else "a number"
        return f"your answer is of type {type(answer).__name__}; expected {expected}"
    if ours.shape != wanted.shape:
        return f"your answer has shape {ours.shape}; expected {wanted.shape}"
    if wanted.dtype == bool and ours.dtype != bool:
        return f"your answer is of type {ours.dtype}; expected bool"
    if ours.dtype.kind not in "biuf":
        return f"your answer is of type {ours.dtype}; expected numbers"
    return _numbers_differ(ours, wanted, tolerance)


def _numbers_differ(ours: NDArray[Any], wanted: NDArray[Any], tolerance: float) -> str:
    lost = np.count_nonzero(np.isnan(ours) & ~np.isnan(wanted))
    if lost:
        return f"{lost} of {ours.size} numbers are NaN: look for 0 / 0, or the logarithm of a negative number"
    scale = np.abs(wanted[np.isfinite(wanted)]).max(initial=0.0) if wanted.dtype.kind == "f" else 0.0
    wrong = ~np.isclose(ours, wanted, rtol=tolerance, atol=tolerance * scale, equal_nan=True)
    if not wrong.any():
        return ""
    far = ~np.isclose(ours, wanted, rtol=1e-5, atol=1e-5 * scale, equal_nan=True)
    if not far.any():
        return "right to about five digits, and no further: do not round, add no tiny number, compute in float64"
    first = tuple(int(i) for i in np.argwhere(far)[0])
    place = f" at {first if len(first) > 1 else first[0]}" if first else ""
    yours = f"yours is {_shown(ours[first])}{place}, expected {_shown(wanted[first])}"
    if wanted.dtype.kind != "b" and np.allclose(
        np.abs(ours), np.abs(wanted), rtol=tolerance, atol=tolerance * scale, equal_nan=True
    ):
        return f"right up to the sign: {yours}"
    things = "answers" if wanted.dtype.kind == "b" else "numbers"
    count = f"{np.count_nonzero(wrong)} of {wrong.size} {things} differ; " if wrong.size > 1 else ""
    return count + yours


def _shown(value: Any) -> str:
    return str(bool(value)) if isinstance(value, np.bool_) else f"{value:.6g}"


def _load_all() -> None:
    for module in iter_modules(import_module("gmmcd_teach.exercises").__path__):
        if module.name.startswith("chapter_"):
            import_module(f"gmmcd_teach.exercises.{module.name}")
