"""Beyond the paper: one mixture, seen through or hidden, alignment, baselines (chapters 14, 15, 16 and 17)."""

from gmmcd_teach.beyond.alignment import align
from gmmcd_teach.beyond.baselines import detect_c2c, detect_m3c2, detect_occupancy, m3c2_distances
from gmmcd_teach.beyond.recommended import detect_recommended
from gmmcd_teach.beyond.shared import changed_components, detect_shared, unbalanced_emd
from gmmcd_teach.beyond.surface import Surface, point_spacing, surface_of
from gmmcd_teach.beyond.visibility import ANSWERS, Looks, judge, looks, looks_from, looks_of_frames

__all__ = [
    "ANSWERS",
    "Looks",
    "Surface",
    "align",
    "changed_components",
    "detect_c2c",
    "detect_m3c2",
    "detect_occupancy",
    "detect_recommended",
    "detect_shared",
    "judge",
    "looks",
    "looks_from",
    "looks_of_frames",
    "m3c2_distances",
    "point_spacing",
    "surface_of",
    "unbalanced_emd",
]
