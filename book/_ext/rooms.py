"""Pages made from the project itself: the map of the chapters, and one page for each module of the package."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from typing import Any

import nbformat
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole
from srcroot import ROOT

QUESTION = re.compile(r"^\*([^*].*?)\*$", re.MULTILINE)


def chapters(found_docs: set[str]) -> dict[int, str]:
    """Number of each chapter in the book and its document."""
    return {int(doc.split("/")[1][:2]): doc for doc in sorted(found_docs) if doc.startswith("notebooks/")}


class FromMyst(SphinxDirective):
    """A directive that writes MyST and has it parsed in place."""

    def parse(self, text: str) -> list[nodes.Node]:
        holder = nodes.container()
        source, _ = self.get_source_info()
        self.state.nested_parse(StringList(text.splitlines(), source), self.content_offset, holder)
        return holder.children


class ChapterMap(FromMyst):
    """A table of the chapters: number, title, question and what it cost to run in this build."""

    def run(self) -> list[nodes.Node]:
        costs = getattr(self.env, "notebook_costs", {})
        rows = ["|   | Chapter | The question | Time | Memory |", "|--:|:--|:--|--:|--:|"]
        for number, doc in chapters(self.env.found_docs).items():
            opening = nbformat.read(ROOT / f"{doc}.ipynb", as_version=4).cells[0].source
            question = QUESTION.search(opening)
            seconds, megabytes = costs.get(doc, (float("nan"), float("nan")))
            cost = f"{seconds:.0f} s | {megabytes:.0f} MB" if doc in costs else "not run | "
            rows.append(f"| {number} | {{doc}}`/{doc}` | {question[1] if question else ''} | {cost} |")
        total = sum(seconds for seconds, _ in costs.values())
        rows += [
            "",
            f"All chapters together: {total / 60:.1f} minutes of computing, measured when this book was built.",
        ]
        return self.parse("\n".join(rows))


class Room(FromMyst):
    """`{room} gmmcd_teach.clouds`: what the module is for, a summary of its public names, then each one in full."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        module = importlib.import_module(self.arguments[0])
        names = [module.__name__]
        if hasattr(module, "__path__"):
            names += [f"{module.__name__}.{part.name}" for part in pkgutil.iter_modules(module.__path__)]
        lines = []
        for name in names:
            own = public_names(name)
            if name != module.__name__:
                lines += [f"## {name.removeprefix('gmmcd_teach.')}", ""]
            lines += ["```{eval-rst}", f".. automodule:: {name}", ""]
            if own:
                lines += [".. autosummary::", "   :nosignatures:", "", *(f"   {item}" for item in own), ""]
                lines += [
                    f".. autoclass:: {name}.{item}\n   :members:\n"
                    if is_class
                    else f".. autofunction:: {name}.{item}\n"
                    for item, is_class in own.items()
                ]
            lines += ["```", ""]
        return self.parse("\n".join(lines))


def public_names(module_name: str) -> dict[str, bool]:
    """Functions and classes that a module defines itself, in the order written; True marks a class."""
    module = importlib.import_module(module_name)
    own = {
        name: item
        for name, item in vars(module).items()
        if not name.startswith("_")
        and (inspect.isfunction(item) or inspect.isclass(item))
        and item.__module__ == module_name
    }
    return {name: inspect.isclass(item) for name, item in own.items()}


def link_chapters(app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]) -> None:
    """Turn "chapter 4" in a docstring into a link to the chapter, where the book has it."""
    where = chapters(app.env.found_docs)

    def link(match: re.Match[str]) -> str:
        number = int(match[0])
        return f":doc:`{number} </{where[number]}>`" if number in where else match[0]

    for i, line in enumerate(lines):
        lines[i] = re.sub(
            r"(?<=chapter )\d+|(?<=chapters )\d+(?:(?:, | and | to )\d+)*",
            lambda phrase: re.sub(r"\d+", link, phrase[0]),
            line,
        )


class Chapter(SphinxRole):
    """{chapter}`4`: a link to the chapter, or plain words where the book does not have it."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        words = f"chapter {self.text}"
        doc = chapters(self.env.found_docs).get(int(self.text))
        if doc is None:
            return [nodes.inline("", words)], []
        link = pending_xref(
            "",
            refdomain="std",
            reftype="doc",
            refdoc=self.env.docname,
            reftarget=f"/{doc}",
            refexplicit=True,
            refwarn=True,
        )
        link += nodes.inline("", words)
        return [link], []


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_role("chapter", Chapter())
    app.add_directive("chapter-map", ChapterMap)
    app.add_directive("room", Room)
    app.connect("autodoc-process-docstring", link_chapters)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
