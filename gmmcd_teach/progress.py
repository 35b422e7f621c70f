"""Progress bars that can be switched off, by the caller or by the environment variable TQDM_DISABLE (chapter 18)."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

from tqdm import tqdm


def progress_bar(items: Iterable[Any] | None = None, *, shown: bool, **options: Any) -> tqdm[Any]:
    """A tqdm bar over `items`, or one to be advanced by hand; silent where not `shown`.

    Examples
    --------
    >>> sum(progress_bar([1, 2, 3], shown=False))
    6
    """
    silenced = os.environ.get("TQDM_DISABLE", "0") not in ("", "0")
    return tqdm(items, disable=silenced or not shown, **options)
