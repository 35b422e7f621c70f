"""The simulated Granite Lab and the real table-top pairs (chapter 1)."""

from gmmcd_teach.lab.pair import DepthFrame, ScenePair
from gmmcd_teach.lab.scenes import SCENES, scene_worlds, simulate_pair
from gmmcd_teach.lab.tabletop import TABLETOP_PAIRS, static_pair, tabletop_available, tabletop_pair

__all__ = [
    "SCENES",
    "TABLETOP_PAIRS",
    "DepthFrame",
    "ScenePair",
    "scene_worlds",
    "simulate_pair",
    "static_pair",
    "tabletop_available",
    "tabletop_pair",
]
