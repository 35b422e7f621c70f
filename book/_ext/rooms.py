"""Pages made from the project itself: the map of the chapters, and one page for each module of the package."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from textwrap import indent
from typing import Any

import nbformat
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.ext import autosummary
from sphinx.util.docutils import SphinxDirective, SphinxRole
from srcroot import ROOT, chapters

QUESTION = re.compile(r"^\*([^*].*?)\*$", re.MULTILINE)


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
        rows = ["| No. | Chapter | The question | Time | Memory |", "|--:|:--|:--|--:|--:|"]
        where = chapters(self.env.found_docs)
        for number, doc in where.items():
            opening = nbformat.read(ROOT / f"{doc}.ipynb", as_version=4).cells[0].source
            question = QUESTION.search(opening)
            seconds, megabytes = costs.get(doc, (float("nan"), float("nan")))
            cost = f"{seconds:.0f}&nbsp;s | {megabytes:.0f}&nbsp;MB" if doc in costs else "not run | "
            rows.append(f"| {number} | {{doc}}`/{doc}` | {question[1] if question else ''} | {cost} |")
        total = sum(costs[doc][0] for doc in where.values() if doc in costs)
        rows += [
            "",
            f"All chapters together: {total / 60:.1f} minutes of computing, measured when this book was built.",
        ]
        return self.parse("\n".join(rows))


class Rooms(FromMyst):
    """A table of the modules named, each with the first line of its docstring and a link to its page."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        rows = ["| Module | What it is for |", "|:--|:--|"]
        for name in " ".join(self.content).split():
            if f"book/api/{name}" in self.env.found_docs:
                summary = (importlib.import_module(f"gmmcd_teach.{name}").__doc__ or "").strip().split("\n")[0]
                phrase = re.search(r"chapters? [\d, and]*\d", summary)
                if phrase:
                    links = re.sub(r"\d+", r"{chapter}`\g<0>`", phrase[0].split(" ", 1)[1])
                    summary = summary.replace(phrase[0], links)
                rows.append(f"| [`{name}`](/book/api/{name}.md) | {summary} |")
        return self.parse("\n".join(rows))


class Room(FromMyst):
    """`{room} gmmcd_teach.clouds`: what the module is for, a summary of its public names, then each one in full."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        module = importlib.import_module(self.arguments[0])
        names = [module.__name__]
        if hasattr(module, "__path__"):
            names += [f"{module.__name__}.{part.name}" for part in pkgutil.iter_modules(module.__path__)]
        return self.parse("\n".join(line for name in names for line in self.describe(name)))

    def describe(self, name: str) -> list[str]:
        own = public_names(name)
        lines = [] if name == self.arguments[0] else [f"## {name.removeprefix('gmmcd_teach.')}", ""]
        lines += ["```{eval-rst}", f".. automodule:: {name}", ""]
        if own:
            lines += [".. autosummary::", "   :nosignatures:", "", *(f"   {item}" for item in own), ""]
        for item, is_class in own.items():
            lines += [f".. auto{'class' if is_class else 'function'}:: {name}.{item}"]
            lines += ["   :members:", ""] if is_class else [""]
        return [*lines, "```", ""]


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


def one_answer(app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]) -> None:
    """Before Napoleon, which takes each line under "Returns" for an answer of its own: they are one text."""
    text = re.sub(
        r"(?<=^Returns\n-------\n)((?:\S.*\n?)+)",
        lambda found: ":\n" + indent(found[0], "    "),
        "\n".join(lines),
        flags=re.MULTILINE,
    )
    lines[:] = text.split("\n")


def polish(app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]) -> None:
    """After Napoleon: "chapter 4" becomes a link, and `points : (N, D) metres` a description instead of a type."""
    where = chapters(app.env.found_docs)

    def link(match: re.Match[str]) -> str:
        number = int(match[0])
        return f":doc:`{number} </{where[number]}>`" if number in where else match[0]

    def appendix(match: re.Match[str]) -> str:
        docs = [doc for doc in app.env.found_docs if doc.startswith(f"notebooks/{match[0]}_")]
        return f":doc:`{match[0]} </{docs[0]}>`" if docs else match[0]

    in_example = False
    for i, line in enumerate(lines):
        in_example = line.lstrip().startswith(">>>") or (in_example and line.strip() != "")
        if in_example:
            continue
        line = re.sub(
            r"(?<=chapter )\d+|(?<=chapters )\d+(?:(?:, | and | to )\d+)*",
            lambda phrase: re.sub(r"\d+", link, phrase[0]),
            line,
        )
        # a norm, |x|, and a name that ends in an underscore mean something else to docutils
        line = re.sub(r"`[^`]*`|\||\w_(?!\w)", lambda part: re.sub(r"^\||_$", r"\\\g<0>", part[0]), line)
        line = re.sub(r"(?<=appendix )[A-F]\b", appendix, line)
        lines[i] = re.sub(r"^(.*\*\*[^*]+\*\*) \((\*?)(.+?)\2\)(?: -- |$)", r"\1 -- \3 ", line).rstrip()


def keep_tags(app: Sphinx, doctree: nodes.document) -> None:
    r"""The paper's equation numbers, \tag{8}, in formulas of several lines: Sphinx puts them where TeX forbids it."""
    for formula in doctree.findall(nodes.math_block):
        text = formula.astext()
        tags = re.findall(r"\\tag\*?\{[^}]*\}", text)
        if not tags or r"\\" not in text or formula.get("nowrap"):
            continue
        if len(tags) == 1:
            body = text.replace(tags[0], "").strip()
            text = rf"\begin{{equation*}}\begin{{split}}{body}\end{{split}}{tags[0]}\end{{equation*}}"
        else:
            text = rf"\begin{{align*}}{text.strip()}\end{{align*}}"
        formula.children = [nodes.Text(text)]
        formula["nowrap"] = True


def list_attributes(app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]) -> None:
    """After Napoleon: the attributes of a class become a plain list, "name -- description"."""
    text = re.sub(r"^:vartype (.+?): (.*)$", r":ivar \1: \2", "\n".join(lines), flags=re.MULTILINE)
    attributes: dict[str, list[str]] = {}
    for found in re.finditer(r"^:ivar (.+?): ?(.*(?:\n +\S.*)*)", text, re.MULTILINE):
        attributes.setdefault(found[1], []).insert(0, " ".join(found[2].split()))
    if attributes:
        rest = re.sub(r"^:ivar .*(?:\n +\S.*)*\n?", "", text, flags=re.MULTILINE)
        bullets = [f"* **{name}** -- {' '.join(parts).strip()}" for name, parts in attributes.items()]
        lines[:] = [*rest.rstrip().splitlines(), "", ".. rubric:: Attributes", "", *bullets, ""]


def skip_foreign(app: Sphinx, what: str, name: str, member: object, skip: bool, options: object) -> bool:
    """Leave out what a class got from elsewhere, such as scikit-learn's request methods."""
    return skip or not getattr(member, "__module__", "gmmcd_teach").startswith("gmmcd_teach")


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
    autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Eqs.")  # do not end a summary there
    app.add_role("chapter", Chapter())
    app.add_directive("chapter-map", ChapterMap)
    app.add_directive("room", Room)
    app.add_directive("rooms", Rooms)
    app.connect("doctree-read", keep_tags)
    app.connect("autodoc-process-docstring", one_answer, priority=400)
    app.connect("autodoc-process-docstring", list_attributes, priority=600)
    app.connect("autodoc-process-docstring", polish, priority=700)
    app.connect("autodoc-skip-member", skip_foreign)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
