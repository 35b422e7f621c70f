"""Figures and 3-D views that speak one visual language: every chapter draws with these, from chapter 1 on."""

from .animation import player
from .cards import picture
from .plots import (
    plot_clouds,
    plot_confusion,
    plot_extraction,
    plot_flow,
    plot_history,
    plot_mixture,
    plot_scores,
)
from .scenes import Boxes, Camera, Ellipsoids, Frusta, Lines, Points
from .style import COLORS, use_style
from .views import share_viewer, view

__all__ = [
    "COLORS",
    "Boxes",
    "Camera",
    "Ellipsoids",
    "Frusta",
    "Lines",
    "Points",
    "picture",
    "player",
    "plot_clouds",
    "plot_confusion",
    "plot_extraction",
    "plot_flow",
    "plot_history",
    "plot_mixture",
    "plot_scores",
    "share_viewer",
    "use_style",
    "view",
]
