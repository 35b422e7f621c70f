"""The 3-D viewer is the same in every view: keep it once in the book instead of once for each view."""

from __future__ import annotations

from typing import Any

from sphinx.application import Sphinx
from sphinx.util import logging

from gmmcd_teach.figures import share_viewer

logger = logging.getLogger(__name__)


def share(app: Sphinx, problem: Exception | None) -> None:
    """After a build that went well, take the viewer out of the pages."""
    if problem is None and app.builder.format == "html":
        saved = share_viewer(app.outdir)
        if saved:
            logger.info("3-D viewer shared by all views: %.1f MB saved", saved / 1e6)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("build-finished", share)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
