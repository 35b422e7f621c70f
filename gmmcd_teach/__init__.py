"""Learn how a machine notices that a room has changed: Gaussian mixtures, the Earth Mover's Distance, point clouds."""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from gmmcd_teach.clouds import CloudError, read_cloud, read_fields, write_cloud
from gmmcd_teach.detection import Detection
from gmmcd_teach.em import MixtureFit, fit_mixture
from gmmcd_teach.emd import Transport, bures_distances, emd, mean_distances
from gmmcd_teach.extraction import Extraction, extract_changes
from gmmcd_teach.filtering import Voxels, statistical_outlier_mask, voxel_downsample
from gmmcd_teach.mdl import description_length
from gmmcd_teach.methods import METHODS, detect_changes
from gmmcd_teach.metrics import Confusion, component_truth, confusion
from gmmcd_teach.mixture import GaussianMixture
from gmmcd_teach.pca import PrincipalAxes, principal_axes

if TYPE_CHECKING:
    from gmmcd_teach.estimator import MDLGaussianMixture
    from gmmcd_teach.lab import DepthFrame, ScenePair, simulate_pair, tabletop_pair

__version__ = version("gmmcd-teach")

__all__ = [
    "METHODS",
    "CloudError",
    "Confusion",
    "DepthFrame",
    "Detection",
    "Extraction",
    "GaussianMixture",
    "MDLGaussianMixture",
    "MixtureFit",
    "PrincipalAxes",
    "ScenePair",
    "Transport",
    "Voxels",
    "bures_distances",
    "component_truth",
    "confusion",
    "description_length",
    "detect_changes",
    "emd",
    "extract_changes",
    "fit_mixture",
    "mean_distances",
    "principal_axes",
    "read_cloud",
    "read_fields",
    "simulate_pair",
    "statistical_outlier_mask",
    "tabletop_pair",
    "voxel_downsample",
    "write_cloud",
]

_LATER = {  # imported when first asked for, so that the core does not wait for scikit-learn or the lab
    "MDLGaussianMixture": "gmmcd_teach.estimator",
    **dict.fromkeys(("DepthFrame", "ScenePair", "simulate_pair", "tabletop_pair"), "gmmcd_teach.lab"),
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(import_module(_LATER[name]), name)
    raise AttributeError(f"module 'gmmcd_teach' has no attribute {name!r}")
