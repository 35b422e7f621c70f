"""Statistical outlier removal and the voxel grid on 200,000 points beside Open3D's; left out where that is absent."""

from __future__ import annotations

from collections.abc import Iterator

from gmmcd_teach import statistical_outlier_mask, voxel_downsample
from tests.benchmarks.timing import Ratio, lab_cloud, medians


def measure(quick: bool) -> Iterator[Ratio]:
    """One line for each filter, wall-clock time: both programs may use all cores for the neighbours."""
    try:
        import open3d
    except ImportError:
        print("   left out: Open3D is not installed (pip install open3d, in an environment of its own)")
        return
    points = lab_cloud(2_000 if quick else 200_000)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    seconds = medians(
        {
            "ours, outliers": lambda: statistical_outlier_mask(points, 50, 1.0),
            "theirs, outliers": lambda: cloud.remove_statistical_outlier(50, 1.0),
            "ours, voxels": lambda: voxel_downsample(points, 0.02),
            "theirs, voxels": lambda: cloud.voxel_down_sample(0.02),
        },
        2 if quick else 9,
        wall=True,
    )
    for filtered in ("outliers", "voxels"):
        ratio = seconds[f"ours, {filtered}"] / seconds[f"theirs, {filtered}"]
        yield Ratio(f"{filtered}: time of Open3D's", ratio, 1.5, at_most=True)
