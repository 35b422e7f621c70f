"""A chapter's number is its file's: notebooks/18_... is chapter 18, whichever chapters stand before it."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.environment.collectors.toctree import TocTreeCollector


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


def setup(app: Sphinx) -> dict[str, Any]:
    count_figures = TocTreeCollector.assign_figure_numbers

    def assign_figure_numbers(self: TocTreeCollector, env: BuildEnvironment) -> list[str]:
        renumber(env)  # after the sections have their numbers, before the figures take theirs
        return count_figures(self, env)

    TocTreeCollector.assign_figure_numbers = assign_figure_numbers  # type: ignore[method-assign]
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
