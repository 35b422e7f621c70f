"""Experiments over seeds, with scores and intervals; the paper measured anew (chapters 10 to 12) and its ledger."""

from gmmcd_teach.study.claims import CLAIMS, RULES, VERDICTS, Claim, verdict
from gmmcd_teach.study.explain import CHANGES, explained_runs, only
from gmmcd_teach.study.fragments import merge_fragments, merged_confusion
from gmmcd_teach.study.grids import GRIDS, LEAF, LEAVES, SIZES, measured
from gmmcd_teach.study.intervals import Interval, mean_interval, share_interval, summary
from gmmcd_teach.study.ledger import MEASURES, ledger, welch
from gmmcd_teach.study.runs import run
from gmmcd_teach.study.runtime import PUBLISHED_RUNTIME, growth, pareto_front, runtime_runs
from gmmcd_teach.study.scans import backwards, cloud_sizes, scan
from gmmcd_teach.study.scores import component_confusion, object_confusion, score
from gmmcd_teach.study.sweep import at_edge, scored_rows, sweep_runs
from gmmcd_teach.study.tables import PUBLISHED_METRICS, harmonic_bounds, metric_runs, metric_table, scan_means

__all__ = [
    "CHANGES",
    "CLAIMS",
    "GRIDS",
    "LEAF",
    "LEAVES",
    "MEASURES",
    "PUBLISHED_METRICS",
    "PUBLISHED_RUNTIME",
    "RULES",
    "SIZES",
    "VERDICTS",
    "Claim",
    "Interval",
    "at_edge",
    "backwards",
    "cloud_sizes",
    "component_confusion",
    "explained_runs",
    "growth",
    "harmonic_bounds",
    "ledger",
    "mean_interval",
    "measured",
    "merge_fragments",
    "merged_confusion",
    "metric_runs",
    "metric_table",
    "object_confusion",
    "only",
    "pareto_front",
    "run",
    "runtime_runs",
    "scan",
    "scan_means",
    "score",
    "scored_rows",
    "share_interval",
    "summary",
    "sweep_runs",
    "verdict",
    "welch",
]
