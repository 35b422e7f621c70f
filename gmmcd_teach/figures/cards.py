"""Cards: a picture with its caption and its text for those who cannot see it, as HTML that needs no network."""

from __future__ import annotations

import base64
import hashlib
import io
import itertools
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .style import INK, PAPER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CARD_STYLE = (
    f".gmmcd-card{{margin:.5rem 0 1rem;padding:.6rem;max-width:60rem;border-radius:.5rem;background:{PAPER};"
    f"color:{INK};box-sizing:border-box;font:14px/1.45 system-ui,sans-serif}}"
    f".gmmcd-card figcaption{{margin:.5rem 0 0;color:{INK};font:inherit;text-align:left}}"
    ".cell_output .text_html:has(>.gmmcd-card){background:none!important;padding:0!important}"
    ".gmmcd-card img{display:block;max-width:100%;height:auto;margin:0 auto;padding:0!important}"
)
_numbers = itertools.count(1)


def unique_id(kind: str, content: bytes) -> str:
    """Return an id that no other element of a page has: what it is, a digest of its content, a running number."""
    return f"gmmcd-{kind}-{hashlib.sha256(content).hexdigest()[:8]}-{next(_numbers)}"


def checked_alt(alt: str) -> str:
    """Return the text alternative, or refuse to draw without one.

    Examples
    --------
    >>> checked_alt("  ")
    Traceback (most recent call last):
    ValueError: alt: say in words what the picture shows
    """
    if not isinstance(alt, str) or not alt.strip():
        raise ValueError("alt: say in words what the picture shows")
    return " ".join(alt.split())


def png(figure: Figure, *, dpi: float = 200, n_colors: int = 255) -> bytes:
    """Return the figure as a small PNG of at most `n_colors` colours (2 to 256): half are its commonest ones."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    image = Image.open(buffer).convert("RGB")
    counted: list[Any] = sorted(image.getcolors(maxcolors=image.width * image.height) or [], reverse=True)
    common = [channel for _, color in counted[: n_colors // 2] for channel in color]
    between = image.quantize(n_colors - n_colors // 2, dither=Image.Dither.NONE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(common + between[: 3 * (n_colors - n_colors // 2)])
    small = io.BytesIO()
    image.quantize(palette=palette, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return small.getvalue()


def image_tag(data: bytes, alt: str, *, width: float | None = None, attributes: str = "") -> str:
    """Return an <img> with the PNG inside it; `width` in CSS pixels. The class keeps dark themes from dimming it."""
    size = f' style="width:{width:.0f}px"' if width else ""
    source = base64.b64encode(data).decode()
    return f'<img class="dark-light"{size} alt="{escape(alt)}" src="data:image/png;base64,{source}"{attributes}>'


def card(body: str, caption: str | None = None, *, identity: str, style: str = "") -> str:
    """Return the <figure> around `body`; `caption` is plain text."""
    below = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return f'<figure class="gmmcd-card" id="{identity}"><style>{CARD_STYLE}{style}</style>{body}{below}</figure>'


@dataclass(frozen=True)
class Picture:
    """A still picture as a notebook shows it: `data` (PNG), `alt`, `caption`, `width` in CSS pixels."""

    data: bytes
    alt: str
    caption: str | None
    width: float

    def _repr_html_(self) -> str:
        image = image_tag(self.data, self.alt, width=self.width)
        return card(image, self.caption, identity=unique_id("picture", self.data))

    def save(self, path: str | Path) -> None:
        """Write the PNG."""
        Path(path).write_bytes(self.data)


def picture(figure: Figure, *, alt: str, caption: str | None = None) -> Picture:
    """Return a matplotlib figure as a card with alt text and caption, and close the figure.

    Parameters
    ----------
    figure : what was drawn.
    alt : what the picture shows, in words, for readers who do not see it.
    caption : what to look at.

    Raises
    ------
    ValueError
        No alt text.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> figure = Figure(figsize=(2, 1))
    >>> _ = figure.subplots().plot([1, 2, 1])
    >>> "one peak" in picture(figure, alt="A curve with one peak.")._repr_html_()
    True
    """
    import matplotlib.pyplot as plt

    alt = checked_alt(alt)
    data = png(figure)
    plt.close(figure)
    return Picture(data, alt, caption, 100 * figure.get_figwidth())
