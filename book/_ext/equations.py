"""The index of equations: where each equation of the paper lives in the package, the chapters and the tests.

Nothing is typed: functions name equations in their docstrings ("Eq. 8", "Eqs. 9 to 11"), chapters in \\tag{8}, tests in
their names (test_eq_08_...). Algorithm 1 goes by its own name.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import nbformat
from rooms import FromMyst
from sphinx.application import Sphinx
from srcroot import ROOT

EQUATIONS = [str(number) for number in range(1, 24)]
ALGORITHM = "Algorithm 1"
MENTION = re.compile(r"Eqs?\.\s+(\d+(?:(?:,\s+|\s+and\s+|\s+to\s+)\d+)*)")


@dataclass
class Places:
    """Where one equation is named, taught and tested."""

    functions: list[str] = field(default_factory=list)  # "em.fit_mixture"
    chapters: list[str] = field(default_factory=list)  # "notebooks/05_..."
    tests: list[str] = field(default_factory=list)  # "test_equations.test_eq_08_..."


def mentioned(text: str) -> set[str]:
    """Equations that a text names: "Eqs. 2, 4 and 9 to 11" are 2, 4, 9, 10 and 11."""
    found = {ALGORITHM} if ALGORITHM in text else set()
    for phrase in MENTION.findall(text):
        parts = re.split(r"(,\s+|\s+and\s+|\s+to\s+)", phrase)
        found.add(parts[0])
        for before, joint, number in zip(parts[::2], parts[1::2], parts[2::2], strict=False):
            low = int(before) if "to" in joint else int(number)
            found |= {str(n) for n in range(low, int(number) + 1)}
    return found


def definitions(path: Path) -> list[tuple[str, str]]:
    """Dotted name and docstring of every function and class of a file."""
    found: list[tuple[str, str]] = []

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
                name = f"{prefix}.{child.name}"
                found.append((name, ast.get_docstring(child) or ""))
                visit(child, name)

    visit(ast.parse(path.read_text(encoding="utf-8")), path.stem)
    return found


def index(root: Path = ROOT) -> dict[str, Places]:
    """Places of every equation of the paper, and of Algorithm 1."""
    places = {name: Places() for name in [*EQUATIONS, ALGORITHM]}
    for path in sorted((root / "gmmcd_teach").glob("*.py")):
        for name, docstring in definitions(path):
            for equation in mentioned(docstring):
                places[equation].functions.append(name)
    for path in sorted((root / "notebooks").glob("[0-9]*.ipynb")):
        text = "\n".join(c.source for c in nbformat.read(path, as_version=4).cells if c.cell_type == "markdown")
        taught = set(re.findall(r"\\tag\{(\d+)\}", text)) | (
            {ALGORITHM} if "{prf:algorithm} " + ALGORITHM in text else set()
        )
        for equation in taught & set(places):
            places[equation].chapters.append(f"notebooks/{path.stem}")
    for path in sorted((root / "tests").glob("test_*.py")):
        for name, _ in definitions(path):
            numbers = re.search(r"test_eq_((?:\d\d_)+)", name)
            covered = {str(int(n)) for n in numbers[1].strip("_").split("_")} if numbers else set()
            covered |= {ALGORITHM} if "test_algorithm_1" in name else set()
            for equation in covered:
                places[equation].tests.append(name)
    return places


def words(test: str) -> str:
    """What a test says: "test_equations.test_eq_08_a_b" says "a b"."""
    return re.sub(r"^test_(?:eq_(?:\d\d_)+|algorithm_1_)", "", test.split(".")[-1]).replace("_", " ")


class EquationIndex(FromMyst):
    """The index as a table, each name a link."""

    def run(self) -> list[Any]:
        rows = ["| Equation | Functions that name it | Taught in | Tested by |", "|:--|:--|:--|:--|"]
        for equation, where in index().items():
            functions = ", ".join(f"{{py:obj}}`{name} <gmmcd_teach.{name}>`" for name in where.functions)
            chapters = ", ".join(f"{{chapter}}`{int(doc.split('/')[1][:2])}`" for doc in where.chapters)
            tests = ", ".join(words(name) for name in where.tests)
            title = equation if equation == ALGORITHM else f"Eq. {equation}"
            rows.append(f"| {title} | {functions} | {chapters} | {tests} |")
        return self.parse("\n".join(rows))


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("equation-index", EquationIndex)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
