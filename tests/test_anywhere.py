"""The reader's contract: with the wheel alone, every notebook runs in an empty folder, and says what the book says.

The book's engine runs each notebook in an empty folder with the network cut off. Here the package comes from a wheel
besides. Slow: one notebook. With --anywhere: all of them, and their tables are compared with those of the built book.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LIMIT = 300  # seconds for a cell

sys.path.insert(0, str(ROOT / "book" / "_ext"))
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("wheel")]


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = ["wheel", "-q", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT)]
    subprocess.run([sys.executable, "-m", "pip", *build], check=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="session")
def installed(wheel: Path) -> str:
    folder = wheel.parent / "installed"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "-t", str(folder), str(wheel)], check=True
    )
    return str(folder)


def test_the_wheel_holds_the_whole_package_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
    package = [path for path in (ROOT / "gmmcd_teach").rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert inside == {path.relative_to(ROOT).as_posix() for path in package}


def test_a_notebook_finds_the_package_of_the_wheel(installed: str, tmp_path: Path) -> None:
    from execution import run_notebook

    cell = nbformat.v4.new_code_cell("import gmmcd_teach; gmmcd_teach.__file__")
    nbformat.write(nbformat.v4.new_notebook(cells=[cell]), tmp_path / "a.ipynb")
    ((output,),) = run_notebook(tmp_path / "a.ipynb", LIMIT, installed)["outputs"]
    assert output["data"]["text/plain"].strip("'").startswith(installed)


@pytest.mark.parametrize("path", [NOTEBOOKS[2]], ids=lambda path: path.stem)
def test_a_chapter_runs_from_the_wheel(path: Path, installed: str) -> None:
    from execution import run_notebook

    assert run_notebook(path, LIMIT, installed)["seconds"] > 0


@pytest.mark.anywhere
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_same_tables_come_out_twice(path: Path, installed: str) -> None:
    """Once when the book was built, once here; cells with the tag `timed` show measured times."""
    from execution import fingerprint, run_notebook

    notebook = nbformat.read(path, as_version=4)
    kept = ROOT / "_build" / ".executed" / f"{path.stem}-{fingerprint(notebook)}.json"
    if not kept.is_file():
        pytest.skip("the book is not built from these notebooks: jupyter-book build book")
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    first = json.loads(kept.read_text(encoding="utf8"))["outputs"]
    again = run_notebook(path, LIMIT, installed)["outputs"]
    for cell, one, other in zip(cells, first, again, strict=True):
        if "timed" not in cell.metadata.get("tags", []):
            assert words(one) == words(other), cell.source


def words(outputs: list[dict[str, Any]]) -> list[str]:
    """What the outputs of a cell say: streams, tables, Markdown; no pictures, no addresses of objects."""
    said = "".join(output.get("text", "") for output in outputs)  # a stream comes in pieces, cut anywhere
    for output in outputs:
        data = output.get("data", {})
        said += "\n".join("".join(data[kind]) for kind in ("text/markdown", "text/plain") if kind in data)
    return re.sub(r"0x[0-9a-f]+", "", said).split()
