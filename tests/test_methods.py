"""detect_changes: the table of methods, what each is handed, and what is refused before any work is done."""

from __future__ import annotations

from inspect import signature

import numpy as np
import pytest

from gmmcd_teach import METHODS, CloudError, Detection, detect_changes
from gmmcd_teach.detection import detect_greedy
from gmmcd_teach.methods import options_of

CLOUD = np.random.default_rng(0).uniform(0, 1, (200, 3))


@pytest.fixture
def spy(monkeypatch):
    """A method "spy" that keeps what it is handed."""
    handed: dict[str, object] = {}

    def detect(before, after, *, rng, before_origin=None, sharpness=1.0):
        handed.update(before=before, after=after, rng=rng, before_origin=before_origin, sharpness=sharpness)
        return Detection(np.zeros(len(after), bool), np.zeros(len(before), bool))

    monkeypatch.setitem(METHODS, "spy", detect)
    return handed


def test_greedy_by_name_is_the_papers_method():
    other = np.vstack([CLOUD, CLOUD[:50] * 0.1 + 4])
    options = {"max_components": 3, "leaf_size": 0.05, "outlier_filter": True, "n_principal_axes": 2, "rng": 4}
    by_name = detect_changes(CLOUD, other, **options, ground="bures", init="kmeans++")
    directly = detect_greedy(CLOUD, other, **options, ground="bures", init="kmeans++")
    np.testing.assert_array_equal(by_name.appeared, directly.appeared)
    np.testing.assert_array_equal(by_name.disappeared, directly.disappeared)
    np.testing.assert_array_equal(by_name.after_mixture.means, directly.after_mixture.means)
    assert by_name.appeared.any()


def test_a_method_is_handed_what_it_takes_and_no_more(spy):
    detect_changes(
        CLOUD.tolist(), CLOUD[:9], method="spy", rng=7, before_origin=[0, 1, 2], max_components=3, sharpness=2
    )
    np.testing.assert_array_equal(spy["before"], CLOUD)
    assert spy["after"].shape == (9, 3)
    assert (spy["rng"], spy["sharpness"]) == (7, 2)
    np.testing.assert_array_equal(spy["before_origin"], [0.0, 1.0, 2.0])


def test_every_method_takes_only_keywords_and_names_them():
    for name, method in METHODS.items():
        first, second, *others = signature(method).parameters.values()
        assert (first.name, second.name) == ("before", "after"), name
        assert all(p.kind in (p.KEYWORD_ONLY, p.VAR_KEYWORD) for p in others), name
        assert "on_record" not in options_of(method), name


def test_options_for_em_pass_through_greedy():
    assert options_of(detect_greedy) >= {"ground", "mass", "tol", "max_iter", "update", "covariance_floor", "progress"}
    assert options_of(lambda before, after, *, cut: None) == {"cut"}


@pytest.mark.parametrize("method", ["gready", "", "Greedy"])
def test_an_unknown_method_is_refused_with_those_there_are(method):
    with pytest.raises(ValueError, match=f"method = '{method}'; expected one of 'greedy'"):
        detect_changes(CLOUD, CLOUD, method=method)


@pytest.mark.parametrize("option", ["colour", "on_record"])
def test_an_unknown_option_is_refused_with_those_the_method_takes(spy, option):
    with pytest.raises(ValueError, match=f"method 'spy' takes no option '{option}'; options of its own: sharpness"):
        detect_changes(CLOUD, CLOUD, method="spy", **{option: 1})
    with pytest.raises(ValueError, match=rf"method 'greedy' takes no option '{option}'; .*covariance_floor.*, ground"):
        detect_changes(CLOUD, CLOUD, **{option: 1})
    assert not spy


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"before": np.zeros((5, 3)) + np.nan}, "before: 5 of 5 points hold NaN"),
        ({"after": np.zeros(5)}, r"after: shape \(5,\); expected \(N, D\)"),
        ({"after": np.empty((0, 3))}, "after: 0 points; at least 1 needed"),
        ({"after": "scan.ply"}, "after: not an array of numbers"),
        ({"after": np.zeros((5, 2))}, "before, after: 3 and 2 dimensions; expected the same"),
        ({"before_origin": [0.0, 1.0]}, r"before_origin: shape \(2,\); expected \(3,\) finite metres"),
        (
            {"after_origin": [0.0, 1.0, np.nan]},
            r"after_origin: \[0.0, 1.0, nan\] holds NaN or infinity; expected \(3,\)",
        ),
        ({"after_origin": ["here", "or", "there"]}, "after_origin: not an array of numbers"),
    ],
    ids=str,
)
def test_clouds_and_origins_that_cannot_be_used_are_refused(spy, arguments, words):
    with pytest.raises(CloudError, match=words):
        detect_changes(**{"before": CLOUD, "after": CLOUD, **arguments}, method="spy")
    assert not spy
