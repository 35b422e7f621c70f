"""A chapter's number is its file's: notebooks/18_... is chapter 18, whichever chapters stand before it.

And where the text says "chapter 18", the number is a link.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.environment.collectors.toctree import TocTreeCollector
from sphinx.transforms.post_transforms import SphinxPostTransform
from srcroot import chapters

MENTION = re.compile(r"[Cc]hapters?\s\d+(?:(?:, | to | and |, and )\d+)*")
NO_PROSE = (nodes.reference, nodes.literal, nodes.literal_block, nodes.title, nodes.math, nodes.math_block, nodes.raw)


def renumber(env: BuildEnvironment) -> None:
    """Replace the running number of each chapter, in its headings and in every table of contents."""
    for doc, sections in env.toc_secnumbers.items():
        chapter = re.match(r"notebooks/(\d\d)_", doc)
        if chapter is None:
            continue
        number = int(chapter[1])
        env.toc_secnumbers[doc] = {place: (number, *old[1:]) if old else old for place, old in sections.items()}
        for node in [env.titles[doc], *env.tocs[doc].findall(nodes.reference)]:
            if node.get("secnumber"):
                node["secnumber"] = [number, *node["secnumber"][1:]]


class ChapterLinks(SphinxPostTransform):
    """Make the numbers in "chapter 5" and "chapters 2 to 9" links."""

    default_priority = 900

    def run(self, **_: Any) -> None:
        for text in list(self.document.findall(nodes.Text)):
            if MENTION.search(text) and not inside(text, NO_PROSE):
                text.parent.replace(text, self.linked(str(text)))

    def linked(self, text: str) -> list[nodes.Node]:
        where, parts, done = chapters(self.env.found_docs), [], 0
        for mention in MENTION.finditer(text):
            for number in re.compile(r"\d+").finditer(text, *mention.span()):
                target = where.get(int(number[0]), self.env.docname)
                if target != self.env.docname:
                    uri = self.app.builder.get_relative_uri(self.env.docname, target)
                    title = self.env.titles[target].astext()
                    link = nodes.reference("", number[0], refuri=uri, internal=True, reftitle=title)
                    parts += [nodes.Text(text[done : number.start()]), link]
                    done = number.end()
        return [*parts, nodes.Text(text[done:])]


def inside(node: nodes.Node, kinds: tuple[type, ...]) -> bool:
    while (node := node.parent) is not None:
        if isinstance(node, kinds):
            return True
    return False


def setup(app: Sphinx) -> dict[str, Any]:
    count_figures = TocTreeCollector.assign_figure_numbers

    def assign_figure_numbers(self: TocTreeCollector, env: BuildEnvironment) -> list[str]:
        renumber(env)  # after the sections have their numbers, before the figures take theirs
        return count_figures(self, env)

    app.add_post_transform(ChapterLinks)
    TocTreeCollector.assign_figure_numbers = assign_figure_numbers  # type: ignore[method-assign]
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
