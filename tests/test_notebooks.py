"""Every notebook keeps the rules of CONTRIBUTING.md: no outputs, small cells, the opening, alt text for figures."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf8"))["project"]["version"]
BOUNDS = ("ten seconds", "half a minute", "one minute", "two minutes", "three minutes")
OPENING = re.compile(
    r"# (?P<title>[^\n]+)\n\n"
    r"\*(?P<question>[^*\n]+\?)\*\n\n"
    r"- \*\*You will\*\* .+?\.\n- \*\*You need\*\* .+?\.\n- \*\*You learn\*\* .+?\.\n"
    rf"- \*\*It runs\*\* in under (?:{'|'.join(BOUNDS)})\.",
    re.DOTALL,
)
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code_cells(path: Path) -> list[Any]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


def number(path: Path) -> str:
    """The number of a chapter, "04", or the letter of an appendix, "B"."""
    return path.stem.split("_")[0]


def figure_cells(path: Path) -> list[Any]:
    return [cell for cell in code_cells(path) if "figure" in cell.metadata.get("mystnb", {})]


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS
    assert all(re.fullmatch(r"(\d\d|[A-F])_[a-z0-9_]+\.ipynb", path.name) for path in NOTEBOOKS)


@each_notebook
def test_is_valid_and_runs_on_the_plain_kernel(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    ids = [cell.id for cell in notebook.cells]
    assert len(set(ids)) == len(ids)


@each_notebook
def test_has_no_outputs(path: Path) -> None:
    for cell in code_cells(path):
        assert cell.outputs == [], f"cell {cell.id}: strip outputs with nbstripout --keep-id"
        assert cell.execution_count is None
    assert "widgets" not in read(path).metadata


@each_notebook
def test_opens_with_question_aims_and_time(path: Path) -> None:
    assert OPENING.match(read(path).cells[0].source), "the first cell is not the opening that CONTRIBUTING.md shows"


@each_notebook
def test_checks_that_book_and_package_agree(path: Path) -> None:
    assert f'assert version("gmmcd-teach") == "{VERSION}"' in code_cells(path)[0].source


@each_notebook
def test_code_cells_are_short(path: Path) -> None:
    long = {cell.id: cell.source.count("\n") + 1 for cell in code_cells(path) if cell.source.count("\n") >= 40}
    assert long == {}


@each_notebook
def test_figures_have_name_caption_and_alt_text(path: Path) -> None:
    for cell in figure_cells(path):
        figure, alt = cell.metadata.mystnb.figure, cell.metadata.mystnb.get("image", {}).get("alt", "")
        assert figure.get("name", "").startswith(f"fig-{number(path)}-"), f"cell {cell.id}: {figure.get('name')}"
        assert len(figure.get("caption", "").split()) >= 8, f"{figure.name}: say what to look at"
        assert len(alt.split()) >= 8, f"{figure.name}: describe the picture"
        assert alt != figure.caption


@each_notebook
def test_a_cell_that_shows_a_plot_is_a_figure(path: Path) -> None:
    figures = {cell.id for cell in figure_cells(path)}
    shown = {cell.id for cell in code_cells(path) if re.search(r"^plt\.show\(\)", cell.source, re.MULTILINE)}
    assert shown <= figures, f"cells {sorted(shown - figures)} show a plot without caption and alt text"


def test_figure_names_and_exercise_labels_are_unique() -> None:
    names = [cell.metadata.mystnb.figure.name for path in NOTEBOOKS for cell in figure_cells(path)]
    sources = [cell.source for path in NOTEBOOKS for cell in read(path).cells]
    labels = [label for source in sources for label in re.findall(r"^:label: (\S+)", source, re.MULTILINE)]
    assert len(set(names)) == len(names)
    assert len(set(labels)) == len(labels)


@each_notebook
def test_exercises_have_hint_stub_check_and_folded_solution(path: Path) -> None:
    cells = read(path).cells
    for position, cell in enumerate(cells):
        for label in re.findall(r"^:{3,}\{exercise\}[^\n]*\n:label: (\S+)", cell.source, re.MULTILINE):
            assert re.fullmatch(rf"ex-{number(path)}-\d", label)
            assert "<details>" in cell.source, f"{label}: no hint"
            after = cells[position + 1 :]
            stub = next(cell for cell in after if cell.cell_type == "code")
            assert f'check("{label}"' in stub.source, f"{label}: the stub's cell does not call check"
            solution = next(cell for cell in after if "hide-cell" in cell.metadata.get("tags", []))
            assert f'check("{label}"' in solution.source, f"{label}: the solution's cell does not call check"
            assert solution.metadata.get("jupyter", {}).get("source_hidden") is True


@each_notebook
def test_folded_cells_fold_in_the_book_and_in_jupyterlab(path: Path) -> None:
    for cell in code_cells(path):
        folded = "hide-cell" in cell.metadata.get("tags", [])
        assert cell.metadata.get("jupyter", {}).get("source_hidden", False) == folded, cell.id


@each_notebook
def test_names_nothing_outside_itself(path: Path) -> None:
    text = path.read_text(encoding="utf8")
    assert re.findall(r"(?<![\w.:/])/(?:home|root|tmp|work)/", text) == []
    assert "%pip" not in text
    assert "pickle" not in "".join(cell.source for cell in code_cells(path))
