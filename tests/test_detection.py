"""The paper's whole method: the same as its parts called one by one, and a scene with a known answer."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

from gmmcd_teach import (
    CloudError,
    extract_changes,
    fit_mixture,
    principal_axes,
    statistical_outlier_mask,
    voxel_downsample,
)
from gmmcd_teach.detection import Stopwatch, detect_greedy, em_progress, prepare
from gmmcd_teach.em import Record


def shelf(seed: int, n: int = 600) -> np.ndarray:
    """(n, 3) points on three boards of 0.6 m, 1 m apart: the same boards, drawn anew for each seed."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 0.6, (2, n))
    return np.column_stack([x + np.arange(n) % 3, y, rng.normal(0, 0.01, n)])


# The box stands farther from its other place than from the shelf, so that its removal pays on both sides.


def box(seed: int, place: list[float], n: int = 100) -> np.ndarray:
    return np.asarray(place) + np.random.default_rng(seed).uniform(-0.1, 0.1, (n, 3))


BEFORE = np.vstack([shelf(0), box(0, [-5.0, 0.3, 0.0])])
AFTER = np.vstack([shelf(1), box(1, [8.0, 0.3, 0.0])])
FAST = {"max_components": 6, "init": "kmeans++", "min_components": 4, "tol": 1e-4}


def test_an_object_moved_over_a_shelf_is_seen_on_both_sides():
    detection = detect_greedy(BEFORE, AFTER, max_components=4, min_components=4, init="kmeans++", rng=1)
    np.testing.assert_array_equal(np.flatnonzero(detection.appeared), np.arange(600, 700))
    np.testing.assert_array_equal(np.flatnonzero(detection.disappeared), np.arange(600, 700))
    assert len(detection.appeared_components) == len(detection.disappeared_components) == 1
    mean = detection.after_mixture.means[detection.appeared_components[0]]
    np.testing.assert_allclose(mean, [8.0, 0.3, 0.0], atol=0.02)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"leaf_size": 0.1},
        {"outlier_filter": True},
        {"outlier_filter": True, "leaf_size": 0.1},
        {"n_principal_axes": 1},
        {"n_principal_axes": 3},
        {"leaf_size": 0.1, "n_principal_axes": 2},
        {"mass": "partial"},
        {"update": "componentwise"},
    ],
    ids=str,
)
def test_the_same_as_its_parts_one_by_one(options):
    detection = detect_greedy(BEFORE, AFTER, rng=5, **FAST, **options)
    fits, clouds = dict(FAST), [BEFORE, AFTER]
    fits |= {name: value for name, value in options.items() if name == "update"}
    filtered = clouds
    if options.get("outlier_filter"):
        filtered = [s[statistical_outlier_mask(s)] for s in filtered]
    if "leaf_size" in options:
        filtered = [voxel_downsample(s, options["leaf_size"]).centroids for s in filtered]
    if "n_principal_axes" in options:
        axes = principal_axes(np.vstack(filtered))
        clouds, filtered = ([axes.project(s, options["n_principal_axes"]) for s in pair] for pair in (clouds, filtered))
    rng = np.random.default_rng(5)
    old, new = (fit_mixture(s, rng=rng, **fits).mixture for s in filtered)
    greedy = {name: value for name, value in options.items() if name == "mass"}
    appeared = extract_changes(old, new, **greedy).indices
    disappeared = extract_changes(new, old, **greedy).indices
    np.testing.assert_array_equal(detection.before_mixture.means, old.means)
    np.testing.assert_array_equal(detection.after_mixture.means, new.means)
    np.testing.assert_array_equal(detection.appeared_components, appeared)
    np.testing.assert_array_equal(detection.disappeared_components, disappeared)
    np.testing.assert_array_equal(detection.appeared, np.isin(new.assign(clouds[1]), appeared))
    np.testing.assert_array_equal(detection.disappeared, np.isin(old.assign(clouds[0]), disappeared))
    assert detection.appeared.any()
    assert detection.appeared.dtype == detection.disappeared.dtype == bool


def test_the_ground_distance_holds_in_both_directions():
    """A box becomes a pole, and a pole a box: their shapes count in Bures' distance alone."""
    thing, tall = box(0, [0.0] * 3), [1.0, 1.0, 60.0]
    one, other = np.array([0.3, 2.0, 0.0]), np.array([2.3, -2.0, 0.0])
    before = np.vstack([shelf(0), one + thing, other + tall * thing])
    after = np.vstack([shelf(1), one + tall * thing, other + thing])
    means, bures = (detect_greedy(before, after, ground=ground, rng=8, **FAST) for ground in ("means", "bures"))
    old, new = bures.before_mixture, bures.after_mixture
    np.testing.assert_array_equal(bures.appeared_components, extract_changes(old, new, ground="bures").indices)
    np.testing.assert_array_equal(bures.disappeared_components, extract_changes(new, old, ground="bures").indices)
    assert set(bures.appeared_components) != set(means.appeared_components)
    assert set(bures.disappeared_components) != set(means.disappeared_components)


def test_25_components_and_seed_0_where_nothing_else_is_asked_for():
    before, after = BEFORE[::10], AFTER[::10]
    told, untold = (
        detect_greedy(before, after, max_components=25, rng=0, max_iter=1),
        detect_greedy(before, after, max_iter=1),
    )
    np.testing.assert_array_equal(untold.after_mixture.means, told.after_mixture.means)


def test_the_answer_is_about_the_points_as_given():
    before, after = BEFORE, np.vstack([AFTER, [[50.0, 50.0, 50.0]]])  # one outlier, filtered on the way
    detection = detect_greedy(before, after, leaf_size=0.2, outlier_filter=True, **FAST)
    assert detection.appeared.shape == (701,)
    assert detection.disappeared.shape == (700,)


def test_filters_work_in_the_papers_order():
    cloud = np.vstack([AFTER, [[50.0, 50.0, 50.0]]])
    expected = voxel_downsample(cloud[statistical_outlier_mask(cloud)], 0.1).centroids
    np.testing.assert_array_equal(prepare(cloud, 0.1, True), expected)
    assert prepare(cloud, None, False) is cloud


def test_a_seed_gives_the_same_answer_and_a_generator_moves_on():
    one, two = (detect_greedy(BEFORE, AFTER, rng=3, **FAST) for _ in range(2))
    np.testing.assert_array_equal(one.appeared, two.appeared)
    np.testing.assert_array_equal(one.after_mixture.covariances, two.after_mixture.covariances)
    rng = np.random.default_rng(3)
    first, second = (detect_greedy(BEFORE, AFTER, rng=rng, **FAST) for _ in range(2))
    np.testing.assert_array_equal(first.after_mixture.means, one.after_mixture.means)
    assert not np.array_equal(second.after_mixture.means, one.after_mixture.means)


def test_the_seconds_add_up():
    seconds = detect_greedy(BEFORE, AFTER, **FAST).seconds
    assert list(seconds) == ["filter", "pca", "em", "emd", "total"]
    assert min(seconds.values()) >= 0
    assert seconds["em"] > 0
    assert sum(seconds.values()) == pytest.approx(2 * seconds["total"], rel=1e-9)


def test_a_stopwatch_adds_to_the_step_that_ended(monkeypatch):
    times = iter([10.0, 11.0, 13.0, 16.0, 20.0])
    monkeypatch.setattr("gmmcd_teach.detection.perf_counter", lambda: next(times))
    watch = Stopwatch()
    for step in ("em", "emd", "em", "votes"):
        watch(step)
    assert watch.seconds == {"filter": 0, "pca": 0, "em": 4, "emd": 2, "votes": 4, "total": 10}


def test_progress_is_shown_when_asked_for(capsys, monkeypatch):
    monkeypatch.setenv("TQDM_DISABLE", "0")
    detect_greedy(BEFORE, AFTER, **FAST)
    assert capsys.readouterr().err == ""
    detect_greedy(BEFORE, AFTER, progress=True, **FAST)
    shown = capsys.readouterr().err
    assert "EM" in shown
    assert "/12" in shown
    assert "K=6" in shown
    assert "K=4" in shown


def test_the_bar_advances_once_for_each_number_of_components(monkeypatch):
    bar = mock.MagicMock()
    monkeypatch.setattr("gmmcd_teach.detection.progress_bar", lambda **options: bar)
    with em_progress(12, True) as on_record:
        for event in ("start", "step", "annihilated", "removed", "step"):
            on_record(Record(5, 0.0, 0.0, event))
    assert bar.__enter__().update.call_args_list == [mock.call(1), mock.call(1)]


def test_nothing_is_changed_in_place():
    before, after = BEFORE.copy(), AFTER.copy()
    detect_greedy(before, after, leaf_size=0.1, n_principal_axes=2, **FAST)
    np.testing.assert_array_equal(before, BEFORE)
    np.testing.assert_array_equal(after, AFTER)


@pytest.mark.parametrize(
    ("before", "options", "error", "words"),
    [
        (BEFORE[:3], {}, CloudError, "^before: 3 points; at least 6 needed"),
        (BEFORE, {"leaf_size": 100.0}, CloudError, "^before: . points; at least 6 needed"),
        (BEFORE[:, :2], {}, CloudError, r"after: shape \(700, 3\); expected \(N, D\) with D = 2"),
        (BEFORE[:, :2], {"n_principal_axes": 2}, CloudError, r"after: shape \(700, 3\)"),
        (BEFORE * np.nan, {}, CloudError, "before: 700 of 700 points hold NaN"),
        (BEFORE, {"n_principal_axes": 0}, ValueError, "n_principal_axes = 0; expected 1 to 3, or None"),
        (BEFORE, {"n_principal_axes": 4}, ValueError, "n_principal_axes = 4; expected 1 to 3"),
        (BEFORE, {"n_principal_axes": "all"}, ValueError, "n_principal_axes = 'all'"),
        (BEFORE, {"leaf_size": -1.0}, ValueError, "leaf_size"),
        (BEFORE, {"ground": "air"}, ValueError, "ground = 'air'; expected one of 'means', 'bures'"),
        (BEFORE, {"mass": "lost"}, ValueError, "mass = 'lost'"),
        (BEFORE, {"update": "online"}, ValueError, "update = 'online'"),
    ],
)
def test_what_cannot_be_done_is_refused(before, options, error, words):
    with pytest.raises(error, match=words):
        detect_greedy(before, AFTER, **FAST, **options)


@pytest.mark.parametrize("wrong", [0, 2.0, "25"])
def test_a_number_of_components_that_is_none_is_named(wrong):
    cloud = np.random.default_rng(0).normal(size=(40, 3))
    with pytest.raises(ValueError, match=rf"^max_components = {wrong!r}; expected a whole number of at least 1$"):
        detect_greedy(cloud, cloud, max_components=wrong)
    assert detect_greedy(cloud, cloud, max_components=1).after_mixture.n_components == 1


def test_the_cloud_that_cannot_be_fitted_is_named():
    cloud = np.random.default_rng(0).normal(size=(40, 3))
    with pytest.raises(CloudError, match=r"^after: 3 points; at least 25 needed$"):
        detect_greedy(cloud, cloud[:3])
    with pytest.raises(CloudError, match=r"^before: 3 points; at least 25 needed$"):
        detect_greedy(cloud[:3], cloud)
