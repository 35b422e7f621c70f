"""The benchmarks run and print; how fast they are is no test."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_each_benchmark_prints_its_ratio_beside_its_target() -> None:
    command = [sys.executable, "-m", "tests.benchmarks", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    parts = done.stdout.strip().split("\n\n")
    assert [part[0] for part in parts] == ["1", "2", "3", "4", "5", "6"]
    for part in parts:
        assert "target: at " in part or "Open3D is not installed" in part


@pytest.mark.slow
def test_a_benchmark_is_called_by_its_number() -> None:
    command = [sys.executable, "-m", "tests.benchmarks", "7"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "numbers are 1 to 6" in done.stderr
