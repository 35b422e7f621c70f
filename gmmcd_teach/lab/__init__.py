"""The simulated Granite Lab and the real table-top pairs (chapter 1)."""

from gmmcd_teach.lab.pair import DepthFrame, ScenePair
from gmmcd_teach.lab.scenes import SCENES, scene_worlds, simulate_pair

__all__ = ["SCENES", "DepthFrame", "ScenePair", "scene_worlds", "simulate_pair"]
