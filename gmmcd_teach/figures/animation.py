"""A player for moving figures: a play button and a slider that work in a page with no kernel and no network."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from .cards import card, checked_alt, image_tag, png, unique_id

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STYLE = (
    ".gmmcd-bar{display:flex;gap:.6rem;align-items:center;margin-top:.4rem}"
    ".gmmcd-bar button{min-width:4.5rem;min-height:2rem;border:1px solid #8a9099;border-radius:.3rem;background:#fff;"
    "color:#1f2328;font:inherit;cursor:pointer}"
    ".gmmcd-bar input{flex:1;min-width:6rem;accent-color:#0072b2}"
    ".gmmcd-bar output{min-width:7rem;font-variant-numeric:tabular-nums}"
    "@media print{.gmmcd-bar{display:none}}"
)

# With reduced motion asked for, the button moves on by one frame and nothing moves by itself.
_SCRIPT = """
(() => {
  const frames = FRAMES, labels = LABELS, pause = PAUSE;
  for (const card of document.querySelectorAll("#IDENTITY:not([data-ready])")) {
    card.dataset.ready = "yes";
    const [image, button, slider, label] = ["img", "button", "input", "output"].map(tag => card.querySelector(tag));
    const still = matchMedia("(prefers-reduced-motion: reduce)");
    let timer = null;
    const show = i => {
      slider.value = i;
      image.src = "data:image/png;base64," + frames[i];
      label.textContent = labels[i];
      slider.setAttribute("aria-valuetext", labels[i]);
    };
    const name = () => { button.textContent = timer ? "Pause" : still.matches ? "Next" : "Play"; };
    const stop = () => { clearInterval(timer); timer = null; name(); };
    const next = () => show((Number(slider.value) + 1) % frames.length);
    button.onclick = () => {
      if (still.matches) { stop(); next(); return; }
      if (timer) { stop(); return; }
      next();
      timer = setInterval(() => { Number(slider.value) + 1 < frames.length ? next() : stop(); }, pause);
      name();
    };
    slider.oninput = () => { stop(); show(Number(slider.value)); };
    still.addEventListener("change", stop);
    name();
  }
})();
"""


@dataclass(frozen=True)
class Player:
    """An animation as a notebook shows it: `frames` (PNG), their `labels`, `alt`, `caption`, `width` in CSS pixels."""

    frames: tuple[bytes, ...]
    labels: tuple[str, ...]
    alt: str
    caption: str | None
    width: float
    pause: float

    def _repr_html_(self) -> str:
        identity = unique_id("player", b"".join(self.frames))
        encoded = json.dumps([base64.b64encode(frame).decode() for frame in self.frames])
        labels = json.dumps(self.labels).replace("<", "\\u003c")
        script = _SCRIPT.replace("IDENTITY", identity).replace("PAUSE", f"{1000 * self.pause:.0f}")
        script = script.replace("LABELS", labels).replace("FRAMES", encoded)
        first = escape(self.labels[0])
        bar = (
            '<div class="gmmcd-bar" role="group" aria-label="Player"><button type="button">Play</button>'
            f'<input type="range" min="0" max="{len(self.frames) - 1}" value="0" step="1" aria-label="Frame" '
            f'aria-valuetext="{first}"><output aria-live="off">{first}</output></div>'
        )
        body = image_tag(self.frames[0], self.alt, width=self.width) + bar
        return card(body, self.caption, identity=identity, style=_STYLE) + f"<script>{script}</script>"


def player(
    frames: Callable[[Any, int], object] | Sequence[Figure],
    n_frames: int | None = None,
    *,
    alt: str,
    caption: str | None = None,
    labels: Sequence[str] | None = None,
    figsize: tuple[float, float] = (6.4, 4.0),
    ncols: int = 1,
    pause: float = 0.4,
) -> Player:
    """Return an animation with a play button and a slider; nothing moves before the reader asks.

    Parameters
    ----------
    frames : a function `draw(axes, i)` that draws frame i on fresh axes (one Axes, or an array of them for ncols > 1),
        or the figures themselves (they are closed). Set the limits of the axes, or the picture jumps.
    n_frames : number of frames, for a function; 10 to 40 read well.
    alt, caption : what the animation shows, in words; what to look at.
    labels : one per frame, shown beside the slider; "1 of n" without.
    figsize : inches; 100 CSS pixels each.
    pause : seconds per frame.

    Raises
    ------
    ValueError
        No alt text, no frames, or not one label per frame.

    Examples
    --------
    >>> grow = player(lambda axes, i: axes.plot([0, i]), 3, alt="A line that grows.", figsize=(2, 1))
    >>> grow.labels
    ('1 of 3', '2 of 3', '3 of 3')
    """
    import matplotlib.pyplot as plt

    alt = checked_alt(alt)
    count = (n_frames or 0) if callable(frames) else len(frames)
    if count < 1:
        raise ValueError("player: at least one frame needed; give n_frames >= 1 with a draw function, or some figures")
    names = tuple(f"{i + 1} of {count}" for i in range(count)) if labels is None else tuple(map(str, labels))
    if len(names) != count:
        raise ValueError(f"labels: {len(names)} for {count} frames; give one per frame")
    if pause <= 0:
        raise ValueError(f"pause: {pause} s; give a time > 0")

    pictures, width = [], 0.0
    for i in range(count):
        if callable(frames):
            figure, axes = plt.subplots(1, ncols, figsize=figsize)
            frames(axes, i)
        else:
            figure = frames[i]
        pictures.append(png(figure, dpi=150, n_colors=128))
        width = max(width, 100 * figure.get_figwidth())
        plt.close(figure)
    return Player(tuple(pictures), names, alt, caption, width, pause)
