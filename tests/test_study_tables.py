"""What rows depend on, the sweeps of chapters 11 and 12, and the ledger of claims (appendix C)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from gmmcd_teach.study import metric_runs, run
from gmmcd_teach.study import runs as study_runs

SMALL = {"leaf_size": [0.1], "max_components": [4]}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GMMCD_TEACH_CACHE", str(tmp_path))


# ---- what rows depend on -----------------------------------------------------------------------------------------


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


def test_rows_are_kept_by_the_module_of_the_function(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(study_runs, "fingerprint", lambda part="": asked.append(part) or "same")
    run(metric_runs, {"scene": ["cargo_bag"], "seed": [0], **SMALL})
    assert "gmmcd_teach.study.tables" in asked
