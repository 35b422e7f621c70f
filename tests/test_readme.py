"""The README's promises: one command each, an example that runs, a lock that agrees with pyproject.toml."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf8"))["project"]
LOCK = [Requirement(line) for line in (ROOT / "requirements.lock").read_text(encoding="utf8").splitlines()]
EXTRAS = PROJECT["optional-dependencies"]


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def pins() -> dict[str, Version]:
    """Package and version that the lock gives to this Python on this system."""
    here = [pin for pin in LOCK if pin.marker is None or pin.marker.evaluate()]
    return {canonicalize_name(pin.name): Version(next(iter(pin.specifier)).version) for pin in here}


def test_the_first_two_shell_blocks_are_one_command_each() -> None:
    book, test = blocks("sh")
    assert book.count("\n") == test.count("\n") == 1
    assert book.rstrip().endswith("jupyter-book build book")
    assert "pytest" in test
    assert "--nbmake notebooks" in test
    for command in (book, test):
        assert "pip install -q -r requirements.lock -e ." in command


def test_ci_runs_the_blocks_of_the_readme() -> None:
    script = (ROOT / ".ci" / "run").read_text(encoding="utf8")
    shown = subprocess.run(
        ["bash", "-c", script.replace('cd "$(dirname "$0")/.."', "").replace("bash -euo pipefail -c", ":")],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert shown == "".join(f"== {block}" for block in blocks("sh"))


@pytest.mark.slow
def test_the_example_runs() -> None:
    (example,) = blocks("python")
    code_lines = [line for line in example.splitlines() if line.strip()]
    assert len(code_lines) <= 10
    strict = ["-W", "error", "-W", "ignore:invalid escape sequence"]  # which POT has in docstrings
    done = subprocess.run([sys.executable, *strict, "-c", example], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = re.fullmatch(r"(\d+) new points; precision (\S+), recall (\S+)\n", done.stdout)
    assert found is not None, done.stdout
    assert int(found[1]) > 0
    assert min(float(found[2]), float(found[3])) > 0.95


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_lead_to_files(page: str) -> None:
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(encoding="utf8"), flags=re.DOTALL)
    text = re.sub(r"`[^`\n]+`", "", text)
    targets = re.findall(r"\]\(([^)#]+)", text)
    missing = [target for target in targets if "://" not in target and not (ROOT / target).is_file()]
    assert missing == []


def test_the_lock_is_nothing_but_pins() -> None:
    for pin in LOCK:
        assert pin.url is None
        assert [clause.operator for clause in pin.specifier] == ["=="], str(pin)


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
@pytest.mark.parametrize("system", ["linux", "darwin", "win32"])
def test_the_lock_meets_pyproject(python: str, system: str) -> None:
    environment = {"python_version": python, "python_full_version": f"{python}.1", "sys_platform": system}
    environment |= {"platform_system": {"linux": "Linux", "darwin": "Darwin", "win32": "Windows"}[system]}
    locked = {
        canonicalize_name(pin.name): next(iter(pin.specifier)).version
        for pin in LOCK
        if pin.marker is None or pin.marker.evaluate(environment)
    }
    for line in [*PROJECT["dependencies"], *(item for extra in EXTRAS.values() for item in extra)]:
        wanted = Requirement(line)
        version = locked.get(canonicalize_name(wanted.name))
        assert version is not None, f"{wanted.name} is not in requirements.lock"
        assert wanted.specifier.contains(version, prereleases=True), f"{wanted}, but the lock has {version}"


def test_the_lock_is_complete() -> None:
    """Whatever an installed package needs here is pinned, all the way down."""
    locked = pins()
    here = {canonicalize_name(known.name): known.version for known in metadata.distributions()}
    if any(here.get(name) != str(locked[name]) for name in ("numpy", "jupyterlab")):
        pytest.skip("this environment was not installed from requirements.lock")
    todo = [Requirement(line) for line in [*PROJECT["dependencies"], *(i for extra in EXTRAS.values() for i in extra)]]
    seen: set[tuple[str, frozenset[str]]] = set()
    while todo:
        wanted = todo.pop()
        key = (canonicalize_name(wanted.name), frozenset(wanted.extras))
        if key in seen:
            continue
        seen.add(key)
        assert key[0] in locked, f"{key[0]} is not in requirements.lock"
        for line in metadata.requires(wanted.name) or []:
            need = Requirement(line)
            if any(need.marker is None or need.marker.evaluate({"extra": extra}) for extra in [*wanted.extras, ""]):
                todo.append(need)


def test_supported_pythons_are_stated() -> None:
    stated = [line.rsplit(" ", 1)[1] for line in PROJECT["classifiers"] if "Python :: 3." in line]
    assert PROJECT["requires-python"] == f">={stated[0]}"
    assert "Python 3.11 or later" in README
