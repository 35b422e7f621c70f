"""Scores on three levels, intervals, runs that are kept, and the paper's table of metrics."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from gmmcd_teach import CloudError, Confusion, Detection, detect_changes, simulate_pair
from gmmcd_teach.study import (
    PUBLISHED_METRICS,
    Interval,
    backwards,
    cloud_sizes,
    component_confusion,
    harmonic_bounds,
    mean_interval,
    metric_runs,
    metric_table,
    object_confusion,
    run,
    scan,
    scan_means,
    score,
    share_interval,
    summary,
)
from gmmcd_teach.study import runs as study_runs

QUICK = {"leaf_size": 0.08, "max_components": 8}
FEW = {"leaf_size": [0.1], "max_components": [4]}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GMMCD_TEACH_CACHE", str(tmp_path))


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("cargo_bag", 1)


@pytest.fixture(scope="module")
def detection(pair):
    return detect_changes(pair.before, pair.after, **QUICK)


# ---- scores ------------------------------------------------------------------------------------------------------


def test_components_are_counted_as_by_a_loop(pair, detection):
    mixture, owner = detection.after_mixture, detection.after_mixture.assign(pair.after)
    counts = dict.fromkeys(("tp", "fp", "fn", "tn"), 0)
    for k in range(mixture.n_components):
        mine = pair.appeared[owner == k]
        true = mine.size > 0 and mine.mean() > 0.5
        claimed = k in detection.appeared_components
        counts[{(1, 1): "tp", (1, 0): "fp", (0, 1): "fn", (0, 0): "tn"}[claimed, true]] += 1
    table = component_confusion(mixture, detection.appeared_components, pair.after, pair.appeared)
    assert table == Confusion(**counts)
    with pytest.raises(CloudError, match=r"taken: 99 to 99; expected 0 to"):
        component_confusion(mixture, [99], pair.after, pair.appeared)


def test_perfect_claims_score_one_on_every_level(pair, detection):
    perfect = Detection(pair.appeared, pair.disappeared)
    rows = {(row["direction"], row["level"]): row for row in score(perfect, pair)}
    assert {key for key in rows if key[0] == "appeared"} == {("appeared", "point"), ("appeared", "object")}
    assert all(rows["appeared", level]["f1"] == 1 for level in ("point", "object"))
    assert rows["disappeared", "object"]["tp"] == rows["disappeared", "object"]["fp"] == 0
    assert {row["level"] for row in score(detection, pair)} == {"component", "point", "object"}


def blob(center, n=200, rng=0):
    return np.random.default_rng(rng).uniform(-0.1, 0.1, (n, 3)) + center


def test_objects_found_missed_and_falsely_claimed():
    points = np.concatenate([blob([x, 0, 0]) for x in range(4)])
    objects = np.repeat([1, 2, 0, 0], 200)
    claimed = np.zeros(800, dtype=bool)
    claimed[:101] = True  # just more than half of the first
    claimed[200:300] = True  # exactly half of the second: missed, but no false object either
    claimed[400:600] = True  # a false object
    claimed[600:605] = True  # too few points to be a region
    assert object_confusion(points, claimed, objects) == Confusion(tp=1, fp=1, fn=1, tn=0)
    nothing = np.zeros(800, dtype=bool)
    assert object_confusion(points, nothing, objects) == Confusion(0, 0, 2, 0)
    assert object_confusion(points, nothing, np.zeros(800, dtype=int)).f1 == 1
    for wrong in ({"claimed": claimed[1:]}, {"claimed": claimed.astype(int)}, {"objects": objects / 2}):
        with pytest.raises(CloudError, match="expected bool and int"):
            object_confusion(**{"points": points, "claimed": claimed, "objects": objects, **wrong})


def test_a_region_is_false_when_at_most_half_of_it_has_changed():
    points, claimed = blob([0, 0, 0], 100), np.ones(100, dtype=bool)
    objects = np.repeat([1, 0], 50)
    assert object_confusion(points, claimed, objects).fp == 1
    objects[50] = 1
    assert object_confusion(points, claimed, objects).fp == 0


def test_swapping_the_scans_swaps_the_rows(pair, detection):
    turned = Detection(
        detection.disappeared,
        detection.appeared,
        detection.after_mixture,
        detection.before_mixture,
        detection.disappeared_components,
        detection.appeared_components,
    )
    forward = score(detection, pair)
    other = {"appeared": "disappeared", "disappeared": "appeared"}
    back = [{**row, "direction": other[row["direction"]]} for row in score(turned, backwards(pair))]
    key = lambda row: (row["direction"], row["level"])  # noqa: E731
    for a, b in zip(sorted(forward, key=key), sorted(back, key=key), strict=True):
        assert a == pytest.approx(b, nan_ok=True)


def test_clouds_of_a_projection_are_scored_on_the_points_as_given(pair):
    from gmmcd_teach import principal_axes

    flat = detect_changes(pair.before, pair.after, max_components=5, cell_size=0.1, n_principal_axes=2)
    axes = principal_axes(np.concatenate([pair.before, pair.after]))
    rows = score(flat, pair, clouds=(axes.project(pair.before, 2), axes.project(pair.after, 2)))
    assert sum(rows[0][name] for name in ("tp", "fp", "fn", "tn")) == flat.after_mixture.n_components
    with pytest.raises(CloudError):
        score(flat, pair)


# ---- intervals ---------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(-10, 10), min_size=2, max_size=20), st.sampled_from([0.8, 0.95]))
@settings(max_examples=50, deadline=None)
def test_the_t_interval_is_scipys(values, level):
    ours = mean_interval(values, level=level)
    scale = stats.sem(values)
    if scale > 0:
        low, high = stats.t.interval(level, len(values) - 1, np.mean(values), scale)
        assert (ours.low, ours.high) == pytest.approx((low, high), abs=1e-9)
    assert ours.mean == pytest.approx(np.mean(values), abs=1e-12)


def test_the_bootstrap_interval_is_scipys():
    values = np.random.default_rng(3).exponential(size=40)
    ours = mean_interval(values, kind="bootstrap", rng=1)
    theirs = stats.bootstrap((values,), np.mean, method="percentile", n_resamples=4000, rng=2).confidence_interval
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.03)
    assert ours == mean_interval(values, kind="bootstrap", rng=1)


def test_t_intervals_cover_the_mean_as_often_as_they_say():
    samples = np.random.default_rng(0).normal(2.0, 1.0, (2000, 4))
    hits = [abs(2 - (i := mean_interval(x)).mean) <= (i.high - i.low) / 2 for x in samples]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.015)


@given(st.integers(1, 60), st.integers(0, 60), st.sampled_from([0.8, 0.95]))
@settings(max_examples=50, deadline=None)
def test_the_interval_of_a_share_is_scipys(n, cases, level):
    cases = min(cases, n)
    ours = share_interval(np.arange(n) < cases, level=level)
    theirs = stats.binomtest(cases, n).proportion_ci(level, method="exact")
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=1e-9)
    assert (ours.mean, ours.n) == (pytest.approx(cases / n), n)


def test_a_share_of_nothing_and_of_parts():
    assert np.isnan(share_interval([]).mean)
    assert share_interval([0.5, 0.5]) == share_interval([False, True])


def test_each_scan_counts_once():
    """However many starts one scan has, it has one voice; what was never asked has none."""
    runs = pd.DataFrame({"scene": list("aaaaab"), "seed": [0, 0, 0, 0, 1, 0], "f1": [0.0, 0.0, 0.0, np.nan, 1.0, 0.5]})
    voices = scan_means(runs, [], ["f1"])
    assert voices[["scene", "seed", "f1"]].values.tolist() == [["a", 0, 0.0], ["a", 1, 1.0], ["b", 0, 0.5]]
    apart = scan_means(runs.assign(way=list("xyxyxy")), ["way"], ["f1"])
    assert apart[["scene", "way"]].values.tolist() == [["a", "x"], ["a", "y"], ["a", "x"], ["b", "y"]]


def test_few_values_and_wrong_options():
    assert mean_interval([0.5, np.nan], within=(0, 1)) == Interval(0.5, 0.0, 1.0, 1)
    assert mean_interval([0.0, 1.0], within=(0, 1)) == Interval(0.5, 0.0, 1.0, 2)
    assert np.isnan(mean_interval([np.nan]).mean)
    with pytest.raises(ValueError, match="expected one of 't', 'bootstrap'"):
        mean_interval([1.0], kind="z")
    with pytest.raises(ValueError, match="level = 95"):
        mean_interval([1.0], level=95)


def test_a_summary_has_one_row_for_each_group_and_column():
    table = pd.DataFrame({"k": [10, 10, 25], "a": [1.0, 3.0, 5.0], "b": [0.0, 0.0, np.nan]})
    tidy = summary(table, ["k"], ["a", "b"])
    assert tidy[["k", "metric", "n"]].values.tolist() == [[10, "a", 2], [10, "b", 2], [25, "a", 1], [25, "b", 0]]
    assert tidy["mean"].tolist()[:3] == [2, 0, 5]


# ---- runs --------------------------------------------------------------------------------------------------------


def twice(seed, scale=2.0, cloud=None):
    return {"value": scale * seed, "found": seed > 0}


def test_runs_give_one_row_for_each_call_and_option():
    table = run(twice, {"seed": [0, 1], "scale": (1.0, 10.0)})
    assert list(table) == ["seed", "scale", "value", "found"]
    assert table["value"].tolist() == [0.0, 0.0, 1.0, 10.0]
    assert run(twice, [{"seed": 3}, {"seed": 4}])["value"].tolist() == [6.0, 8.0]
    with pytest.raises(TypeError, match="a row holds a set"):
        run(lambda seed: {"value": {1}}, {"seed": [0]})


def test_a_pair_as_an_argument_is_shown_by_its_name(pair):
    assert run(lambda pair: {"n": len(pair.before)}, {"pair": [pair]}).values.tolist() == [
        ["cargo_bag", len(pair.before)]
    ]


@pytest.mark.slow
def test_processes_give_the_same_table():
    grid = {"scene": ["cargo_bag"], "seed": [0, 1], "leaf_size": [0.1], "max_components": [4]}
    alone = run(metric_runs, grid, keep=False)
    pd.testing.assert_frame_equal(run(metric_runs, grid, n_jobs=2, keep=False), alone)


@pytest.mark.slow
def test_what_was_run_once_is_read_the_second_time(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(
        "gmmcd_teach.study.tables.detect_changes", lambda *a, **k: calls.append(k) or detect_changes(*a, **k)
    )
    grid = {"scene": ["cargo_bag"], "seed": [0], "leaf_size": [0.1], "max_components": [4]}
    first = run(metric_runs, grid)
    assert len(calls) == 2
    pd.testing.assert_frame_equal(run(metric_runs, grid), first)
    assert len(calls) == 2
    run(metric_runs, grid | {"max_components": [5]})
    assert len(calls) == 4, "other arguments are run"
    monkeypatch.setattr(study_runs, "fingerprint", lambda folder="": "other sources")
    run(metric_runs, grid)
    assert len(calls) == 6, "a changed package is run"
    kept = list((tmp_path / "study").rglob("*.json"))
    assert len(kept) == 3
    assert all(isinstance(json.loads(path.read_text()), list) for path in kept)


def test_functions_from_elsewhere_are_not_kept(tmp_path):
    assert twice.__module__.split(".")[0] != "gmmcd_teach"
    run(twice, {"seed": [0]})
    assert list(tmp_path.rglob("*.json")) == []


def test_where_nothing_can_be_written_nothing_is_kept(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GMMCD_TEACH_CACHE", str(tmp_path / "file"))
    grid = {"scene": ["cargo_bag"], "seed": [0], "leaf_size": [0.1], "max_components": [4]}
    assert len(run(metric_runs, grid)) == 16  # 2 orders, 2 directions, 4 levels


def test_the_digest_depends_on_the_data(pair):
    array = np.arange(6.0)
    others = [
        array.reshape(2, 3),
        array.astype(np.float32),
        array + 1,
        [0.0, 1.0],
        {"a": 1},
        {"a": 2},
        True,
        1,
        "1",
        None,
    ]
    digests = [study_runs.digest(value) for value in [array, *others]]
    assert len(set(digests)) == len(digests)
    assert study_runs.digest(array.copy()) == digests[0]
    assert study_runs.digest({"b": 1, "a": (2,)}) == study_runs.digest({"a": [2], "b": 1})
    assert study_runs.digest(pair) != study_runs.digest(backwards(pair))
    with pytest.raises(TypeError, match="no digest of a set"):
        study_runs.digest({1})


def test_the_fingerprint_covers_every_source(tmp_path, monkeypatch):
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "a.py").write_text("1")
    (tmp_path / "b.py").write_text("1")
    monkeypatch.setattr(study_runs, "PACKAGE", tmp_path)
    seen = []
    for change in ("", "b.py", "lab/a.py"):
        if change:
            (tmp_path / change).write_text("2")
        study_runs.fingerprint.cache_clear()
        seen.append((study_runs.fingerprint(), study_runs.fingerprint("lab")))
    study_runs.fingerprint.cache_clear()
    assert len({whole for whole, _ in seen}) == 3
    assert [lab == seen[0][1] for _, lab in seen] == [True, True, False]


# ---- scans -------------------------------------------------------------------------------------------------------


def test_a_scan_comes_back_from_disk_as_it_was(pair, tmp_path, monkeypatch):
    fresh = scan("cargo_bag", 1)
    monkeypatch.delattr("gmmcd_teach.study.scans.simulate_pair")  # from now on it has to be read
    kept = scan("cargo_bag", 1)
    for a, b in ((fresh, pair), (kept, pair)):
        assert study_runs.digest(a) == study_runs.digest(b)
    assert isinstance(kept.before_frames[0].intrinsics, tuple)
    assert len(list((tmp_path / "scans").glob("cargo_bag-1-*.npz"))) == 2


def test_a_scan_without_frames_keeps_none_and_a_later_one_finds_them(pair, tmp_path):
    sizes = cloud_sizes("cargo_bag", 1)
    assert sizes == {"before": len(pair.before), "after": len(pair.after)}
    assert len(list((tmp_path / "scans").glob("*.npz"))) == 1
    for _ in range(2):  # simulated, then read
        bare = scan("cargo_bag", 1, frames=False)
        assert bare.before_frames == bare.after_frames == ()
        np.testing.assert_array_equal(bare.after, pair.after)
    assert len(scan("cargo_bag", 1).after_frames) == 1
    assert study_runs.digest(scan("cargo_bag", 1)) == study_runs.digest(pair)
    assert scan("cargo_bag", 1, frames=False).before_frames == ()


def test_scans_of_older_sources_are_dropped(tmp_path):
    folder = tmp_path / "scans"
    folder.mkdir()
    (folder / "cargo_bag-1-0123456789ab.npz").write_bytes(b"")
    (folder / "cargo_bag-11-0123456789ab.npz").write_bytes(b"")
    scan("cargo_bag", 1)
    assert len(list(folder.glob("cargo_bag-1-*"))) == 2, "clouds and frames"
    assert not (folder / "cargo_bag-1-0123456789ab.npz").exists()
    assert (folder / "cargo_bag-11-0123456789ab.npz").exists()


# ---- tables ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_metric_table_averages_what_had_something_to_find():
    runs = run(metric_runs, {"scene": ["cargo_bag", "astrobee"], "seed": [0, 1], "starts": [2], **FEW})
    table = metric_table(runs).set_index(["direction", "metric"])
    for order, direction in (("forward", "appeared"), ("backward", "disappeared")):
        rows = runs[(runs.order == order) & (runs.direction == direction) & (runs.level == "component")]
        assert len(rows) == 8
        assert table.loc[(direction, "f1"), "mean"] == pytest.approx(rows.f1.mean())
        assert table.loc[(direction, "f1"), "n"] == 4, "two starts on each of four scans"
        by_scan = rows.groupby(["scene", "seed"]).f1.mean()
        assert table.loc[(direction, "f1"), "low"] == pytest.approx(mean_interval(by_scan, within=(0, 1)).low)
    assert table.loc["appeared", "paper"].tolist() == PUBLISHED_METRICS["one"].tolist()
    assert table.loc["disappeared", "paper"].isna().all()
    lenient, strict = (runs[runs.level == level].reset_index() for level in ("overlap", "component"))
    assert (lenient.tp + lenient.fn >= strict.tp + strict.fn).all()
    assert (lenient.tp + lenient.fn > strict.tp + strict.fn).any()
    assert metric_table(runs, "point")["paper"].isna().all()
    with pytest.raises(ValueError, match="level = 'pixel'; expected one of 'component', 'point', 'object', 'overlap'"):
        metric_table(runs, "pixel")


def test_the_published_values_are_those_of_the_paper(shared):
    import re

    text = (shared / "paper" / "paper.tex").read_text(encoding="utf8")
    for metric, values in PUBLISHED_METRICS.iterrows():
        line = next(x for x in text.splitlines() if x.strip().lower().startswith(metric) and "&" in x)
        assert [float(x) for x in re.findall(r"\d\.\d{3}", line)] == values.tolist()


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 1)), min_size=1, max_size=8))
@settings(max_examples=200, deadline=None)
def test_no_runs_have_a_mean_f1_outside_the_bounds(runs):
    p, r = np.array(runs).T
    f1 = np.divide(2 * p * r, p + r, out=np.zeros_like(p), where=p + r > 0)
    low, high = harmonic_bounds(p.mean(), r.mean())
    assert low - 1e-9 <= f1.mean() <= high + 1e-9
    wide = harmonic_bounds(p.mean(), r.mean(), 0.01)
    assert wide[0] <= low
    assert wide[1] >= high


def test_the_bounds_are_reached():
    assert harmonic_bounds(0.5, 0.5)[0] == 0  # one run (1, 0), one run (0, 1)
    assert harmonic_bounds(0.75, 0.75)[0] == 0.5  # (1, 1), (1, 1), (1, 0), (0, 1)
    assert harmonic_bounds(0.6, 1.0)[1] == pytest.approx(0.75)  # every run the same
    assert harmonic_bounds(0.0, 0.0) == (0.0, 0.0)


# ---- a cluster ---------------------------------------------------------------------------------------------------

CLUSTER = """
import joblib
import pandas as pd
from dask.distributed import Client, LocalCluster
from gmmcd_teach.study import metric_runs, run

if __name__ == "__main__":
    grid = {"scene": ["cargo_bag", "astrobee"], "seed": [0, 1], "leaf_size": [0.1], "max_components": [4]}
    here = run(metric_runs, grid, keep=False)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        before = set(client.who_has())
        with joblib.parallel_config(backend="dask"):
            there = run(metric_runs, grid, keep=False)
            run(metric_runs, grid)
        processes = set(client.run(__import__("os").getpid).values())
    pd.testing.assert_frame_equal(here, there)
    pd.testing.assert_frame_equal(here, run(metric_runs, grid))
    assert len(processes) == 2
    print("the same table")
"""


@pytest.mark.slow
def test_a_dask_cluster_of_two_workers_gives_the_same_table(tmp_path):
    pytest.importorskip("distributed")
    import subprocess

    (tmp_path / "sweep.py").write_text(CLUSTER)
    done = subprocess.run(
        [sys.executable, "sweep.py"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.stdout.strip() == "the same table", done.stderr[-3000:]
    assert len(list((tmp_path / "study").rglob("*.json"))) == 4
