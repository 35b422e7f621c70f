"""One visual language: what each colour means, and the look that all figures share."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle, islice
from types import MappingProxyType

COLORS: Mapping[str, str] = MappingProxyType(
    {
        "before": "#0072B2",
        "after": "#E69F00",
        "appeared": "#D55E00",
        "disappeared": "#56B4E9",
        "unchanged": "#999999",
        "hidden": "#CCCCCC",
        "truth": "#1F2328",
        "camera": "#5A6472",
    }
)
"""Meaning -> colour (Okabe and Ito's palette, safe for colour-blind readers), the same in every figure and view."""

CYCLE = ("#332288", "#44AA99", "#CC6677", "#999933", "#AA4499", "#117733", "#882255", "#DDCC77")
"""Colours that only tell things apart, as components or methods (Tol's muted palette): none has a meaning."""

PAPER = "#F6F7F8"
INK = "#1F2328"


def color_of(meaning: str) -> str:
    """Return the colour of a meaning; a hex colour such as "#009E73" stands for itself.

    Raises
    ------
    ValueError
        Neither a meaning nor a hex colour.

    Examples
    --------
    >>> color_of("appeared"), color_of("#009e73")
    ('#D55E00', '#009E73')
    """
    if meaning in COLORS:
        return COLORS[meaning]
    if len(meaning) == 7 and meaning[0] == "#" and set(meaning[1:].lower()) <= set("0123456789abcdef"):
        return meaning.upper()
    raise ValueError(f"colour {meaning!r}: not one of {', '.join(COLORS)}, nor a hex colour such as '#009E73'")


def distinct_colors(n: int) -> list[str]:
    """Return `n` colours for telling groups apart, repeating after eight.

    Examples
    --------
    >>> distinct_colors(2)
    ['#332288', '#44AA99']
    """
    return list(islice(cycle(CYCLE), n))


def use_style() -> None:
    """Set matplotlib's defaults to the look of the book: light cards that read well in light and dark mode."""
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "figure.figsize": (6.4, 4.0),
            "figure.dpi": 100,
            "savefig.dpi": 200,
            "figure.facecolor": PAPER,
            "savefig.facecolor": PAPER,
            "axes.facecolor": "white",
            "figure.constrained_layout.use": True,
            "font.size": 10,
            "axes.titlesize": 11,
            "axes.titleweight": "bold",
            "axes.titlelocation": "left",
            "axes.labelcolor": INK,
            "axes.edgecolor": "#8A9099",
            "text.color": INK,
            "xtick.color": INK,
            "ytick.color": INK,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "axes.axisbelow": True,
            "grid.color": "#E3E6E9",
            "grid.linewidth": 0.7,
            "legend.facecolor": "white",
            "legend.edgecolor": "none",
            "legend.framealpha": 0.85,
            "lines.linewidth": 1.8,
            "axes.prop_cycle": plt.cycler(color=list(CYCLE)),
            "image.cmap": "viridis",
        }
    )
