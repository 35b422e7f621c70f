"""The public names, arguments and defaults that the design promises."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys

import numpy as np
import pytest

import gmmcd_teach

PUBLIC = [getattr(gmmcd_teach, name) for name in gmmcd_teach.__all__]
FUNCTIONS = [f for f in PUBLIC if inspect.isfunction(f) and f.__module__.count(".") == 1]  # those of the core
FIELDS = {
    "Voxels": "centroids counts membership",
    "PrincipalAxes": "mean axes variances",
    "GaussianMixture": "weights means covariances",
    "MixtureFit": "mixture description_length log_likelihood history",
    "Transport": "distance flow prices",
    "Extraction": "indices distances",
    "Detection": "appeared disappeared before_mixture after_mixture appeared_components disappeared_components seconds",
    "Confusion": "tp fp fn tn",
}
KEYWORDS_FROM = {"fit_mixture": "tol", "emd": "mass", "extract_changes": "ground", "detect_changes": "method"}


@pytest.mark.slow
def test_the_check_of_the_design(shared):
    script = shared / "checks/contract.py"
    if not script.is_file():
        pytest.skip("no ../shared/checks/contract.py")
    strict = ["-W", "error", "-W", "ignore:invalid escape sequence"]  # which POT has in docstrings
    done = subprocess.run([sys.executable, *strict, script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_promised_name_is_there_once():
    assert len(set(gmmcd_teach.__all__)) == len(gmmcd_teach.__all__)
    for name in gmmcd_teach.__all__:
        assert getattr(gmmcd_teach, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'fit_mixtures'"):
        _ = gmmcd_teach.fit_mixtures


@pytest.mark.parametrize(("name", "fields"), FIELDS.items())
def test_results_are_frozen_and_have_the_promised_fields(name, fields):
    kind = getattr(gmmcd_teach, name)
    if dataclasses.is_dataclass(kind):
        assert [field.name for field in dataclasses.fields(kind)] == fields.split()
        assert kind.__dataclass_params__.frozen
    else:
        assert list(kind._fields) == fields.split()


@pytest.mark.parametrize(("name", "first"), KEYWORDS_FROM.items())
def test_options_are_given_by_name(name, first):
    parameters = list(inspect.signature(getattr(gmmcd_teach, name)).parameters.values())
    kinds = [p.kind for p in parameters]
    start = [p.name for p in parameters].index(first)
    assert set(kinds[:start]) == {inspect.Parameter.POSITIONAL_OR_KEYWORD}
    assert set(kinds[start:]) <= {inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD}


@pytest.mark.parametrize("name", ["fit_mixture", "detect_changes"])
def test_what_draws_numbers_takes_rng(name):
    points = np.random.default_rng(0).normal(size=(60, 2))
    arguments = (points,) if name == "fit_mixture" else (points, points)
    for rng in (0, np.random.default_rng(0), np.int64(0)):
        getattr(gmmcd_teach, name)(*arguments, max_components=2, rng=rng)
    assert inspect.signature(getattr(gmmcd_teach, name)).parameters["rng"].default == 0


def test_cloud_error_is_a_value_error():
    assert issubclass(gmmcd_teach.CloudError, ValueError)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_public_docstrings_say_what_comes_in_what_is_raised_and_show_it(function):
    text = inspect.getdoc(function)
    assert "Raises\n------\nCloudError" in text
    assert "Examples\n--------\n>>>" in text
    for parameter in inspect.signature(function).parameters.values():
        assert parameter.annotation is not inspect.Parameter.empty
        assert parameter.name in text, f"{parameter.name} is not described"
