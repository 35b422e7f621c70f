"""Let `jupyter-book build book` and `jupyter-book build .` read the same folder, and fail on any warning.

Jupyter Book takes the folder it is given as the source folder, so `build book` would not see `notebooks/`. Both
commands end up here, before Sphinx looks for documents: sources are then read from the root, static files from `book/`.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from zlib import crc32

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]


def chapters_wanted() -> list[str]:
    """Chapters named in $BOOK_ONLY ("04 09"), for a quick look at a draft; empty for the whole book."""
    return os.environ.get("BOOK_ONLY", "").replace(",", " ").split()


def chapters(found_docs: set[str]) -> dict[int, str]:
    """Number of each chapter in the book and its document; appendices, `notebooks/B_...`, have none."""
    found = ((re.match(r"notebooks/(\d\d)_", doc), doc) for doc in sorted(found_docs))
    return {int(number[1]): doc for number, doc in found if number}


def read_all_again(app: Sphinx, error: Exception | None) -> None:
    """Sphinx repeats a warning only when it reads the page again: after a warning, the next build reads all pages."""
    if error is None and app._warncount:
        (Path(app.doctreedir) / "environment.pickle").unlink(missing_ok=True)


def remove_old_pages(app: Sphinx, error: Exception | None) -> None:
    """Pages whose source is gone or renamed would stay in the output folder."""
    if error is None and app.builder.name == "html":
        for page in [*Path(app.outdir, "book").rglob("*.html"), *Path(app.outdir, "notebooks").rglob("*.html")]:
            if page.relative_to(app.outdir).with_suffix("").as_posix() not in app.env.found_docs:
                page.unlink()


def setup(app: Sphinx) -> dict[str, Any]:
    app.srcdir = type(app.srcdir)(ROOT)
    app.confdir = type(app.confdir)(ROOT / "book")
    app.config.external_toc_path = str(ROOT / "_toc.yml")  # type: ignore[attr-defined]
    app.config.nitpicky = True  # type: ignore[attr-defined]
    app.keep_going = not chapters_wanted()  # read on after a warning, then exit 1
    app.connect("build-finished", read_all_again)
    app.connect("build-finished", remove_old_pages)
    extensions = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    return {"version": "1", "env_version": crc32(extensions), "parallel_read_safe": True, "parallel_write_safe": True}
