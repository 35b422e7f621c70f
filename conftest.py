"""Settings for every test run: the real scans, the slow tests, one core for each worker."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parent
if (ROOT.parent / "shared" / "real").is_dir():
    os.environ.setdefault("GMMCD_TEACH_DATA", str(ROOT.parent / "shared" / "real"))
os.environ.setdefault("TQDM_DISABLE", "1")
os.environ.setdefault("PYTHONWARNINGS", "ignore:invalid escape sequence")  # in docstrings of POT, when first compiled
for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="run the slow tests, too")
    parser.addoption("--anywhere", action="store_true", help="run every notebook alone from a wheel, too")
    parser.addoption("--scores", action="store_true", help="run the long measurements of scores over seeds, too")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    options = {"slow": "--all", "anywhere": "--anywhere", "scores": "--scores"}
    unasked = [marker for marker, option in options.items() if not config.getoption(option)]
    left_out = [item for item in items if any(item.get_closest_marker(marker) for marker in unasked)]
    if left_out:
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
