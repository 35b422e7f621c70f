"""Checks for the students' own code: each says whether an attempt is right, and if not, what is wrong and why."""

from gmmcd_teach.exercises.checking import EXERCISES, Exercise, Mistake, Verdict, check, judge

__all__ = ["EXERCISES", "Exercise", "Mistake", "Verdict", "check", "judge"]
