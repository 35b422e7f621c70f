"""Experiments with scores, seeds and intervals, and the tables of the paper measured anew (chapters 10 to 12)."""

from gmmcd_teach.study.intervals import Interval, mean_interval, summary
from gmmcd_teach.study.runs import run
from gmmcd_teach.study.scans import backwards, scan
from gmmcd_teach.study.scores import component_confusion, object_confusion, score
from gmmcd_teach.study.tables import PUBLISHED_METRICS, harmonic_bounds, metric_runs, metric_table

__all__ = [
    "PUBLISHED_METRICS",
    "Interval",
    "backwards",
    "component_confusion",
    "harmonic_bounds",
    "mean_interval",
    "metric_runs",
    "metric_table",
    "object_confusion",
    "run",
    "scan",
    "score",
    "summary",
]
