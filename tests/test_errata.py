"""Appendix B: every erratum of the paper and of its code has a row, and every row an answer that its cell computed."""

from __future__ import annotations

import ast
import json
import re
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "notebooks" / "B_errata.ipynb"
IDS = [*(f"P{i}" for i in range(1, 15)), *(f"C{i}" for i in range(1, 11))]
ANSWERS = {"no", "it could", "yes"}

sys.path.insert(0, str(ROOT / "book" / "_ext"))


def sections() -> dict[str, list[Any]]:
    """The cells of each row: its Markdown, headed "### P4", and the code that follows."""
    found: dict[str, list[Any]] = {}
    name = ""
    for cell in nbformat.read(PAGE, as_version=4).cells:
        if cell.cell_type == "markdown":
            headings = re.findall(r"^#{2,3} (.+)$", cell.source, re.MULTILINE)
            name = headings[-1] if headings else name
        found.setdefault(name, []).append(cell)
    return {name: cells for name, cells in found.items() if re.fullmatch(r"[PC]\d+", name)}


def answer_call(cells: list[Any]) -> ast.Call:
    """The one call row(name, differs, published, measured) of a section."""
    nodes = [node for cell in cells if cell.cell_type == "code" for node in ast.walk(ast.parse(cell.source))]
    (call,) = [n for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name) and n.func.id == "row"]
    return call


def test_every_erratum_has_its_row_in_order() -> None:
    assert list(sections()) == IDS


@pytest.mark.parametrize("name", IDS)
def test_a_row_says_what_should_be_and_what_our_code_does(name: str) -> None:
    text = sections()[name][0].source
    assert "**Printed:**" in text or "**Written:**" in text
    assert "**Should be:**" in text
    ours = text.split("- **Ours:**")[1]
    assert "{py:" in ours or "gmmcd_teach" in ours


@pytest.mark.parametrize("name", IDS)
def test_a_row_computes_its_answer_and_its_numbers(name: str) -> None:
    title, differs, _, measured = answer_call(sections()[name]).args
    assert ast.literal_eval(title) == name
    assert any(isinstance(node, ast.FormattedValue) for node in ast.walk(measured)), "the numbers are typed"
    if name != "C10":  # which concerns safety: no number can depend on it
        assert any(isinstance(node, ast.Name) for node in ast.walk(differs)), "the answer is typed"


@pytest.mark.slow
def test_the_summary_has_every_row_with_its_measurement() -> None:
    from execution import fingerprint, run_notebook

    notebook = nbformat.read(PAGE, as_version=4)
    kept = ROOT / "_build" / ".executed" / f"{PAGE.stem}-{fingerprint(notebook)}.json"
    result = json.loads(kept.read_text(encoding="utf8")) if kept.is_file() else run_notebook(PAGE, timeout=120)
    tables = [output["data"]["text/markdown"] for outputs in result["outputs"] for output in outputs
              if "text/markdown" in output.get("data", {})]  # fmt: skip
    (summary,) = [text for text in tables if text.startswith("| Row |")]
    rows = [[part.strip() for part in line.strip("|").split("|")] for line in summary.splitlines()[2:]]
    assert [re.fullmatch(r"\[(\w+)\]\(#(\w+)\)", row[0]).groups() for row in rows] == [(i, i.lower()) for i in IDS]  # type: ignore[union-attr]
    for name, answer, measured in rows:
        assert answer in ANSWERS, name
        assert len(measured.split()) >= 8, name
        assert "nan" not in measured.lower().split(), name
    assert rows[IDS.index("P14")][1] != "no"
