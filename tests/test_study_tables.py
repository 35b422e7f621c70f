"""What rows depend on, the sweeps of chapters 11 and 12, and the ledger of claims (appendix C)."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from gmmcd_teach import (
    CloudError,
    Confusion,
    Detection,
    GaussianMixture,
    component_truth,
    confusion,
    detect_changes,
    principal_axes,
    voxel_downsample,
)
from gmmcd_teach.detection import prepare
from gmmcd_teach.study import (
    CHANGES,
    CLAIMS,
    GRIDS,
    MEASURES,
    PUBLISHED_METRICS,
    PUBLISHED_RUNTIME,
    RULES,
    Claim,
    Interval,
    at_edge,
    explained_runs,
    growth,
    ledger,
    measured,
    merge_fragments,
    merged_confusion,
    metric_runs,
    only,
    pareto_front,
    run,
    runtime_runs,
    scan,
    score,
    scored_rows,
    sweep_runs,
    verdict,
    welch,
)
from gmmcd_teach.study import runs as study_runs
from gmmcd_teach.study.explain import balance, joined, stayed
from gmmcd_teach.study.reasons import WHY
from gmmcd_teach.study.runs import arguments
from gmmcd_teach.study.sweep import notes

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "book" / "_ext"))
TIMED = {"em-dominates", "linear-in-k", "pca-saves"}  # seconds differ from run to run where nothing was kept
TIMED_WHY = {"tradeoff", "downsampling"}
SMALL = {"leaf_size": [0.1], "max_components": [4]}


@pytest.fixture(autouse=True)
def _own_cache(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder for what is kept, but for tests of the page, which reads what the book has kept."""
    if "page" not in request.fixturenames:
        monkeypatch.setenv("GMMCD_TEACH_CACHE", str(tmp_path))


# ---- what rows depend on -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", ["greedy", "shared", "recommended", "c2c", "m3c2", "occupancy"])
def test_every_line_that_makes_a_row_is_in_the_fingerprint(method):
    met = set()

    def note(frame, event, argument):
        met.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        metric_runs("cargo_bag", 0, method=method, leaf_size=0.1)
    finally:
        sys.setprofile(None)
    ran = {path for path in map(Path, met) if study_runs.PACKAGE in path.parents}
    assert study_runs.PACKAGE / "study" / "tables.py" in ran
    assert ran <= study_runs.imported_sources("gmmcd_teach.study.tables")


def test_figures_exercises_and_reports_make_no_row():
    sources = {
        path.relative_to(study_runs.PACKAGE).as_posix()
        for path in study_runs.imported_sources("gmmcd_teach.study.tables")
    }
    assert {"em.py", "beyond/recommended.py", "lab/scenes.py", "formats/atomic.py", "study/scans.py"} <= sources
    assert not any(name.startswith(("figures/", "exercises/", "report", "commands", "__main__")) for name in sources)


def test_imports_of_every_form_are_followed(tmp_path, monkeypatch):
    package = tmp_path / "house"
    files = {
        "__init__.py": "from house.aside import x",
        "room.py": "import house.plain\nfrom house import named\n\ndef f():\n    from .inside import deep as d",
        "plain.py": "",
        "named.py": "import numpy",
        "aside.py": "",
        "other.py": "from house.room import f",
        "inside/__init__.py": "from .near import y",
        "inside/deep.py": "from ..far import z\nfrom . import beside",
        "inside/near.py": "",
        "inside/beside.py": "",
        "far.py": "",
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    monkeypatch.setattr(study_runs, "PACKAGE", package)
    found = {path.relative_to(package).as_posix() for path in study_runs.imported_sources("house.room")}
    assert found == set(files) - {"other.py"}
    found = {path.relative_to(package).as_posix() for path in study_runs.imported_sources("house.plain")}
    assert found == {"plain.py", "__init__.py"}, "what the folder gathers beside it does not count"


def test_only_a_change_in_what_is_imported_runs_again(tmp_path, monkeypatch):
    package = tmp_path / "house"
    package.mkdir()
    for name, text in {"__init__.py": "", "a.py": "import house.b", "b.py": "1", "picture.py": "1"}.items():
        (package / name).write_text(text)
    monkeypatch.setattr(study_runs, "PACKAGE", package)
    seen = []
    for change in ("", "picture.py", "b.py"):
        if change:
            (package / change).write_text("2")
        study_runs.fingerprint.cache_clear()
        seen.append(study_runs.fingerprint("house.a"))
    study_runs.fingerprint.cache_clear()
    assert seen[0] == seen[1] != seen[2]


@pytest.mark.slow
def test_rows_are_kept_by_the_module_of_the_function(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(study_runs, "fingerprint", lambda part="": asked.append(part) or "same")
    run(metric_runs, {"scene": ["cargo_bag"], "seed": [0], **SMALL})
    assert "gmmcd_teach.study.tables" in asked


# ---- fragments ---------------------------------------------------------------------------------------------------


def groups_by_loop(means, taken, reach):
    groups = []
    for k in taken:
        near = [g for g in groups if any(np.linalg.norm(means[k] - means[j]) <= reach for j in g)]
        groups = [g for g in groups if g not in near] + [[int(k), *(j for g in near for j in g)]]
    return sorted(sorted(g) for g in groups)


@given(st.integers(0, 10_000), st.floats(0, 1.5))
@settings(max_examples=60, deadline=None)
def test_fragments_are_merged_as_by_a_loop(seed, reach):
    rng = np.random.default_rng(seed)
    means = rng.random((12, 3)) * 2
    taken = rng.permutation(12)[: rng.integers(0, 12)]
    groups = merge_fragments(means, taken, reach)
    assert sorted(sorted(map(int, g)) for g in groups) == groups_by_loop(means, taken, reach)


def test_merging_with_no_reach_counts_components():
    rng = np.random.default_rng(0)
    means, owner, changed = rng.random((9, 3)), rng.integers(0, 9, 400), rng.random(400) < 0.5
    share = [changed[owner == k].mean() for k in range(9)]
    taken = [4, 1, 7]
    claimed = np.isin(np.arange(9), taken)
    assert merged_confusion(means, taken, owner, changed, 0) == confusion(claimed, np.array(share) > 0.5)
    with pytest.raises(ValueError, match="reach = -1; expected metres"):
        merged_confusion(means, taken, owner, changed, -1)


def test_merging_counts_one_thing_once():
    means = np.array([[0.0, 0], [0.1, 0], [0.2, 0], [5.0, 0], [5.1, 0], [9.0, 0]])
    owner = np.repeat(np.arange(6), 10)
    changed = owner < 5  # a thing in three parts, one in two parts, and a wall
    assert merged_confusion(means, [0, 1], owner, changed, 0.15) == Confusion(1, 0, 1, 1)
    assert merged_confusion(means, [0, 1, 5], owner, changed, 0.15) == Confusion(1, 1, 1, 0)
    assert merged_confusion(means, [], owner, changed, 0.15) == Confusion(0, 0, 2, 1)
    assert merged_confusion(means, [0, 3, 5], owner, changed, 20) == Confusion(1, 0, 0, 0), "all in one"


# ---- run times ---------------------------------------------------------------------------------------------------


@given(st.floats(-2, 3), st.floats(0.01, 100))
@settings(max_examples=50, deadline=None)
def test_growth_finds_the_exponent(b, a):
    x = np.array([10.0, 15, 20, 30, 50])
    found = growth(x, a * x**b)
    assert found.mean == pytest.approx(b, abs=1e-9)
    assert found.low <= found.mean <= found.high


def test_the_interval_of_the_exponent_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(0)
    x = np.array([15.0, 20, 25, 30, 40, 50])
    found = [growth(x, 0.1 * x**1.4 * np.exp(rng.normal(0, 0.2, 6))) for _ in range(1500)]
    assert np.mean([i.low <= 1.4 <= i.high for i in found]) == pytest.approx(0.95, abs=0.02)


def test_the_exponents_interval_is_that_of_a_straight_line():
    rng = np.random.default_rng(1)
    x = np.array([15.0, 20, 25, 30, 40, 50])
    y = 0.1 * x**1.4 * np.exp(rng.normal(0, 0.2, 6))
    line, ours = stats.linregress(np.log(x), np.log(y)), growth(x, y)
    half = stats.t.ppf(0.975, 4) * line.stderr
    assert (ours.mean, ours.low, ours.high) == pytest.approx((line.slope, line.slope - half, line.slope + half))


@pytest.mark.parametrize(("x", "y"), [([1, 2], [1, 2]), ([1, 2, 3], [1, 2]), ([1, 2, 3], [0, 1, 2])])
def test_growth_wants_three_numbers_above_zero(x, y):
    with pytest.raises(CloudError, match="expected at least three numbers above 0"):
        growth(x, y)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=12))
@settings(max_examples=200, deadline=None)
def test_the_front_is_that_of_a_loop(choices):
    cost, value = np.array(choices).T
    front = [not any(c2 <= c and v2 >= v and (c2 < c or v2 > v) for c2, v2 in choices) for c, v in choices]
    assert pareto_front(cost, value).tolist() == front


def test_the_published_run_times_are_those_of_the_paper(shared):
    text = (shared / "paper" / "paper.tex").read_text(encoding="utf8")
    for k, row in PUBLISHED_RUNTIME.iterrows():
        line = next(x for x in text.splitlines() if re.match(rf"\s*{k} &", x))
        assert [float(x) for x in re.findall(r"\d+\.\d{3}", line)] == row.tolist()


@pytest.mark.slow
def test_timed_steps_are_those_of_the_detector():
    row = runtime_runs("cargo_bag", 1, 6, leaf_size=0.1, n_principal_axes=None)
    pair = scan("cargo_bag", 1)
    same = detect_changes(pair.before, pair.after, max_components=6, leaf_size=0.1, rng=np.random.default_rng([1]))
    assert (row["n_before"], row["n_after"]) == (same.before_mixture.n_components, same.after_mixture.n_components)
    assert row["n_points"] == sum(len(voxel_downsample(c, 0.1).centroids) for c in (pair.before, pair.after))
    assert row["n_steps"] <= row["updates"] <= 6 * row["n_steps"]
    assert row["pca"] == 0
    assert row["em"] > row["emd"]


# ---- one detection from every side -------------------------------------------------------------------------------


@pytest.mark.slow
def test_rows_of_the_sweep_are_those_of_score():
    options = {"leaf_size": 0.08, "max_components": 8}
    rows = {row["level"]: row for row in sweep_runs("cargo_bag", 1, **options)}
    pair = scan("cargo_bag", 1)
    found = detect_changes(pair.before, pair.after, rng=np.random.default_rng([1, 0]), **options)
    for row in score(found, pair, overlap=0.1):
        if row["direction"] == "appeared":
            assert all(
                rows[row["level"]][name] == pytest.approx(row[name], nan_ok=True)
                for name in row
                if name in rows["point"]
            )
    assert rows["point"]["n_after"] == found.after_mixture.n_components
    assert rows["point"]["claimed"] == pytest.approx(found.appeared.mean())
    assert rows["point"]["n_true"] == component_truth(found.after_mixture, pair.after, pair.appeared).sum()
    assert rows["merged"]["tp"] + rows["merged"]["fp"] <= rows["point"]["n_taken"]
    other = sweep_runs("cargo_bag", 1, start=1, **options)[0]
    assert (other["n_taken"], other["claimed"]) != (rows["point"]["n_taken"], rows["point"]["claimed"])
    with pytest.raises(ValueError, match="without mixtures"):
        scored_rows(Detection(pair.appeared, pair.disappeared), pair, (pair.before, pair.after))


@pytest.mark.slow
def test_rows_after_pca_are_counted_in_its_coordinates():
    options = {"leaf_size": 0.08, "max_components": 8, "n_principal_axes": 2}
    row = sweep_runs("cargo_bag", 1, **options)[0]
    pair = scan("cargo_bag", 1)
    found = detect_changes(pair.before, pair.after, rng=np.random.default_rng([1, 0]), **options)
    thin = [voxel_downsample(c, 0.08).centroids for c in (pair.before, pair.after)]
    flat = principal_axes(np.concatenate(thin)).project(pair.after, 2)
    assert row["n_true"] == component_truth(found.after_mixture, flat, pair.appeared).sum()


def test_found_and_missed_objects_are_named():
    pair = scan("cargo_bag", 1)
    none = notes(np.zeros(len(pair.after), dtype=bool), pair)
    assert (none["found"], none["missed"], none["claimed"]) == ("", "cargo bag", 0)
    assert np.isnan(none["edge_false"])
    everything = notes(np.ones(len(pair.after), dtype=bool), pair)
    assert everything["found"] == "cargo bag"
    assert everything["edge_false"] == everything["edge_all"]


def test_the_edge_is_that_of_the_outline():
    rng = np.random.default_rng(0)
    disc = rng.normal(size=(4000, 3))
    disc[:, 2] *= 0.01
    disc[:, :2] *= (np.sqrt(rng.random(4000)) / np.linalg.norm(disc[:, :2], axis=1))[:, None]
    inside = np.linalg.norm(disc[:, :2], axis=1) < 0.8
    assert (at_edge(disc, 0.2) == ~inside).mean() > 0.97


# ---- one thing changed at a time ---------------------------------------------------------------------------------

COARSE = {"leaf_size": 0.1, "max_components": 8}


@pytest.mark.slow
def test_nothing_changed_is_the_sweep():
    changed, swept = explained_runs("cargo_bag", 1, **COARSE), sweep_runs("cargo_bag", 1, **COARSE)
    for a, b in zip(changed, swept, strict=True):
        both = b.keys() - {"cpu", "em_share"}
        assert {name: a[name] for name in both} == pytest.approx({name: b[name] for name in both}, nan_ok=True)
    with pytest.raises(ValueError, match="change = 'luck'; expected one of 'as it is', 'no shadows'"):
        explained_runs("cargo_bag", 1, "luck")


def test_what_is_left_out_and_what_has_stayed():
    pair = scan("cargo_bag", 1)
    seen = only(pair, ~pair.hidden_before, ~pair.hidden_after)
    assert not seen.hidden_after.any()
    assert len(seen.after) == (~pair.hidden_after).sum()
    same = stayed(pair)
    np.testing.assert_array_equal(same.after[~same.appeared], pair.before)
    np.testing.assert_array_equal(same.after[same.appeared], pair.after[pair.appeared])
    assert not same.hidden_before.any()
    assert not same.hidden_after.any()
    p, q = (GaussianMixture([1.0], [[m]], [[[1.0]]]) for m in (0.0, 5.0))
    points = np.linspace(-3, 8, 9)[:, None]
    both = np.log((30 * np.exp(p.log_density(points)) + 10 * np.exp(q.log_density(points))) / 40)
    np.testing.assert_allclose(joined(p, 30, q, 10).log_density(points), both)


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_each_change_leaves_out_what_it_says(change, monkeypatch):
    from gmmcd_teach.study import explain

    pair, fitted = scan("cargo_bag", 1), []
    monkeypatch.setattr(explain, "prepare", lambda cloud, *a: fitted.append(cloud) or prepare(cloud, *a))
    explained_runs("cargo_bag", 1, change, **COARSE)
    without = {"no shadows": (True, True), "no lost wall": (True, False), "no new wall": (False, True)}
    cut = without.get(change, (False, False))
    sizes = [(~(hidden & on)).sum() for hidden, on in zip((pair.hidden_before, pair.hidden_after), cut, strict=True)]
    if change in ("one scan", "one fit"):
        sizes[1] = len(pair.before) + pair.appeared.sum()
    if change == "no edges":
        sizes = [(~at_edge(cloud)).sum() for cloud in (pair.before, pair.after)]
    assert [len(cloud) for cloud in fitted[:2]] == sizes


def test_the_object_may_take_the_mass_of_the_wall_that_it_hides():
    wall, behind, thing = [5.0, 0, 0], [0.0, 0, 0], [0.0, 0.3, 0]
    pair = replace(
        scan("cargo_bag", 1),
        before=np.array([wall, wall, behind]),
        hidden_before=np.array([False, False, True]),
        after=np.array([wall, wall, thing]),
        after_objects=np.array([0, 0, 1]),
    )
    old, new = (GaussianMixture([0.8, 0.2], [wall, m], [0.01 * np.eye(3)] * 2) for m in (behind, thing))
    assert balance(old, new, pair) == pytest.approx({"from_lost": 1, "gain_true": 0.2 * 0.3 - 0.2 * 5}), (
        "it does not pay"
    )
    seen = replace(pair, hidden_before=np.zeros(3, dtype=bool))
    assert balance(GaussianMixture([1.0], [wall], [np.eye(3)]), new, seen) == pytest.approx(
        {"from_lost": 0, "gain_true": 0.2 * np.hypot(5, 0.3)}
    )


CLUSTER = """
import os
import joblib
import pandas as pd
from dask.distributed import Client, LocalCluster
from gmmcd_teach.study import explained_runs, run, runtime_runs, sweep_runs

CLOCKS = ["cpu", "em_share", "load", "pca", "em", "emd", "total"]
FUNCTIONS = {sweep_runs: {}, runtime_runs: {}, explained_runs: {"change": ["no shadows", "one fit"]}}

if __name__ == "__main__":
    grid = {"scene": ["cargo_bag"], "seed": [0, 1], "leaf_size": [0.1], "max_components": [4]}
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        assert len(set(client.run(os.getpid).values()) - {os.getpid()}) == 2
        for function, more in FUNCTIONS.items():
            here = run(function, grid | more, keep=False)
            with joblib.parallel_config(backend="dask"):
                there = run(function, grid | more, keep=False)
            pd.testing.assert_frame_equal(*(t.drop(columns=CLOCKS, errors="ignore") for t in (here, there)))
            print(function.__name__)
"""


@pytest.mark.slow
def test_the_sweeps_run_on_a_dask_cluster_of_two_workers(tmp_path):
    pytest.importorskip("distributed")
    (tmp_path / "sweep.py").write_text(CLUSTER)
    done = subprocess.run(
        [sys.executable, "sweep.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.stdout.split() == ["sweep_runs", "runtime_runs", "explained_runs"], done.stderr[-3000:]


# ---- the ledger --------------------------------------------------------------------------------------------------


def test_every_claim_has_a_rule_a_measurement_and_a_reason():
    names = [claim.name for claim in CLAIMS]
    assert len(set(names)) == len(names)
    assert set(MEASURES) == set(names)
    assert {claim.rule for claim in CLAIMS} == set(RULES)
    explained = {claim.name for claim in CLAIMS if claim.rule not in ("value", "seconds")}
    assert set(WHY) == explained


def test_the_ledger_has_every_number_of_the_papers_tables():
    values = {claim.name: claim.value for claim in CLAIMS}
    for k, row in PUBLISHED_RUNTIME.iterrows():
        assert [values[f"time-{k}-{step}"] for step in row.index] == row.tolist()
    for objects, column in PUBLISHED_METRICS.items():
        assert [values[f"{metric}-{objects}"] for metric in column.index] == column.tolist()


def test_a_claim_without_a_measurement_fails(monkeypatch):
    with pytest.raises(ValueError, match="'k-star' has no measurement"):
        verdict(next(c for c in CLAIMS if c.name == "k-star"), Interval(np.nan, np.nan, np.nan, 0))
    monkeypatch.delitem(MEASURES, CLAIMS[0].name)
    with pytest.raises(ValueError, match="has no measurement"):
        ledger({})


@pytest.mark.parametrize(
    ("rule", "value", "interval", "expected"),
    [
        ("value", 0.9, (0.7, 0.8999), "reproduced"),
        ("value", 0.9, (0.7, 0.899), "not reproduced"),
        ("value", 0.9, (0.901, 0.95), "not reproduced"),
        ("percent", 0.1, (0.0, 0.095), "reproduced"),
        ("percent", 0.1, (0.0, 0.09), "not reproduced"),
        ("range", (20.0, 23.0), (20.0, 22.5), "reproduced"),
        ("range", (20.0, 23.0), (19.9, 22.5), "not reproduced"),
        ("similar", (-0.1, 0.1), (-0.1, 0.05), "reproduced"),
        ("similar", (-0.1, 0.1), (-0.05, 0.2), "not reproduced"),
        ("linear", (0.75, 1.25), (1.0, 1.3), "not reproduced"),
        ("most", 0.5, (0.51, 1.0), "reproduced"),
        ("most", 0.5, (0.5, 1.0), "not reproduced"),
        ("above", 0.0, (-0.01, 1.0), "not reproduced"),
        ("seconds", 5.0, (5.0, 5.0), "not comparable"),
        ("open", None, (0.0, 1.0), "not comparable"),
    ],
)
def test_rules_decide_as_they_say(rule, value, interval, expected):
    low, high = interval
    claim = Claim("x", "", "", value, rule, "")
    assert verdict(claim, Interval((low + high) / 2, low, high, 10)) == expected
    assert verdict(claim, Interval((low + high) / 2, low, high, 5)) == expected
    assert verdict(claim, Interval((low + high) / 2, low, high, 4)) == "not comparable", "too few scans to tell"


@given(st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_the_difference_of_groups_is_scipys(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(1, 2, 7), rng.normal(0, 0.5, 12)
    theirs = stats.ttest_ind(a, b, equal_var=False).confidence_interval(0.95)
    ours = welch([*a, np.nan], b)
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high))
    assert ours.n == 7, "the smaller group"


def test_a_group_of_one_has_no_interval():
    assert welch([1.0], [0.0, 2.0]) == Interval(0.0, -np.inf, np.inf, 1)
    assert welch([1.0, 1.0], [0.0, 0.0, 0.0]) == Interval(1.0, 1.0, 1.0, 2)


def metric_rows(n_scans, n_starts, f1=lambda scan, start: 0.5):
    """Rows as of `metric_runs`, for one scene of two objects, in both orders."""
    ways = {"forward": "appeared", "backward": "disappeared"}
    rows = [
        {"scene": "two_objects", "seed": seed, "start": start, "objects": "two", "order": order, "direction": direction}
        | {"level": "component", "f1": f1(seed, start) * (order == "forward")}
        for seed in range(n_scans) for start in range(n_starts) for order, direction in ways.items()
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_more_starts_on_a_scan_do_not_narrow_an_interval():
    by_scan = [0.1, 0.5, 0.2, 0.9, 0.4]
    few, many = ({"metrics": metric_rows(5, starts, lambda scan, _: by_scan[scan])} for starts in (1, 8))
    for name in ("f1-two", "disappearances-similar"):
        assert vars(MEASURES[name](many)) == pytest.approx(vars(MEASURES[name](few)))
        assert MEASURES[name](many).n == 5
    mean, half = np.mean(by_scan), stats.t.ppf(0.975, 4) * stats.sem(by_scan)
    assert MEASURES["f1-two"](many).low == pytest.approx(max(mean - half, 0))


def test_where_all_scans_agree_a_share_keeps_a_width():
    frames = pd.DataFrame({"level": "object", "scene": "cargo_bag", "seed": range(10), "fp": 3})
    clean = MEASURES["frame-clean"]({"frames": frames})
    theirs = stats.binomtest(0, 10).proportion_ci(0.95, method="exact")
    assert (clean.low, clean.high, clean.n) == (0, pytest.approx(theirs.high), 10)


def test_the_ledger_asks_for_the_runs_of_chapter_10():
    """Its grids are written in the chapter; the same arguments are taken from what was kept."""
    source = "\n".join(c.source for c in nbformat.read(ROOT / "notebooks" / "10_scoring_a_detector.ipynb", 4).cells
                       if c.cell_type == "code")  # fmt: skip
    values = {
        node.targets[0].id: node.value.value
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
    }
    grids = {
        node.targets[0].id: eval(compile(ast.Expression(node.value), "grid", "eval"), {**values, "range": range})
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") in ("one", "many")
    }
    asked = [job for grid in grids.values() for job in arguments(grid)]
    assert {study_runs.digest(job) for job in asked} == {study_runs.digest(job) for job in GRIDS["metrics"][1]}


def test_tables_are_asked_for_by_name():
    assert all(jobs for _, jobs in GRIDS.values())
    tables = ("metrics", "sweep", "frames", "plane", "cleaned")
    seeds = {(job["scene"], job["seed"]) for name in tables for job in GRIDS[name][1]}
    for scene in ("cargo_bag", "astrobee", "two_objects", "three_objects"):
        assert {seed for name, seed in seeds if name == scene} >= set(range(10)), "ten seeds of every scene"
    with pytest.raises(ValueError, match="no table 'luck'; expected one of 'metrics'"):
        measured("luck")


LEDGER = ROOT / "notebooks" / "C_ledger.ipynb"


@pytest.fixture(scope="module")
def page():
    """The outputs of appendix C as the book has them, and the tables that it read."""
    from execution import fingerprint, run_notebook

    notebook = nbformat.read(LEDGER, as_version=4)
    kept = ROOT / "_build" / ".executed" / f"{LEDGER.stem}-{fingerprint(notebook)}.json"
    result = json.loads(kept.read_text(encoding="utf8")) if kept.is_file() else run_notebook(LEDGER, timeout=120)
    texts = [
        o["data"]["text/markdown"]
        for outputs in result["outputs"]
        for o in outputs
        if "text/markdown" in o.get("data", {})
    ]
    return texts, ledger({name: measured(name, progress=False) for name in GRIDS})


@pytest.mark.slow
def test_the_page_says_what_the_tables_say(page):
    texts, book = page
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for text in texts if text.startswith("| Claim")
            for line in text.splitlines()[2:]]  # fmt: skip
    assert len(rows) == len(CLAIMS)
    rows = [[cell.replace("\\", "").replace("\u00a0", " ") for cell in row] for row in rows]
    shown = {tuple(row[0].split("<br>")[:2]): row for row in rows}
    for claim in book.itertuples():
        about, ours, judged = shown[f"**{claim.says}**", f"paper: {claim.paper}"]
        by = "too few scans" if claim.few else claim.rule
        assert judged == f"{claim.verdict}<br>({by})", claim.claim
        if claim.rule != "seconds" and claim.claim not in TIMED:
            mean = re.match(rf"\*\*(-?[\d.]+)\*\*<br>\[(-?[\d.]+), (-?[\d.]+)\]<br>(\d+) {claim.unit}", ours)
            assert mean is not None, ours
            shown_here, computed = map(float, mean.groups()), [claim.mean, claim.low, claim.high, claim.n]
            assert list(shown_here) == pytest.approx(computed, abs=0.0051)
            assert about.endswith(f"<br>{claim.why}") or claim.claim in TIMED_WHY
    assert (book.loc[book["few"], "n"] < 5).all()
    assert (book.loc[book["few"], "verdict"] == "not comparable").all()
    counts = book["verdict"].value_counts()
    assert any(all(f"**{n}** {name}" in text for name, n in counts.items()) for text in texts)
