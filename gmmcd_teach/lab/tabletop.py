"""Real scans with the truth: four table-top pairs of a depth camera, and a room in which nothing changed (chapter 17).

The files are those of the modified Object Segmentation Database in PointCloudLibrary/data (BSD-3-Clause; Richtsfeld et
al. 2012, TU Wien), one fixed camera of Kinect's kind for each pair. They are not part of the package: they are looked
for nearby, and else fetched once. Wherever a file comes from, its SHA-256 must be the recorded one.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gmmcd_teach.clouds import CloudError, Floats, read_fields
from gmmcd_teach.lab.pair import Bools, DepthFrame, ScenePair

SOURCE = "https://raw.githubusercontent.com/PointCloudLibrary/data/5c26bdd0591ba150b91858b5c9fe5e91cb39ae86"
INTRINSICS = (525.0, 525.0, 319.5, 239.5)  # px; every point of these files lies on the ray of its pixel with them
NOISE = 0.015  # m; two readings of one still surface differ by less in 999 of 1000 pixels


@dataclass(frozen=True)
class _Pair:
    """Two files, and which objects of the first are gone from, of the second new to, the scene: label -> name."""

    before: str
    after: str
    description: str
    removed: dict[int, str] = field(default_factory=dict)
    added: dict[int, str] = field(default_factory=dict)


_PAIRS = {
    "tea_box_moved_front_to_back": _Pair(
        before="learn6",
        after="learn7",
        description="A tea box went from before a cereal box to behind it.",
        removed={20: "tea box"},
        added={30: "tea box"},
    ),
    "tea_box_moved_sideways": _Pair(
        before="learn9",
        after="learn10",
        description="A tea box was put to the left of a cereal box, on its side.",
        removed={20: "tea box"},
        added={20: "tea box"},
    ),
    "tea_box_moved_back_to_front": _Pair(
        before="learn14",
        after="learn15",
        description="A tea box came from behind two cereal boxes to the front.",
        removed={40: "tea box"},
        added={20: "tea box"},
    ),
    "bowl_removed_two_cups_added": _Pair(
        before="learn37",
        after="learn38",
        description="A bowl was taken away and two cups were put down; a tin and a pot stayed.",
        removed={30: "bowl"},
        added={20: "first cup", 30: "second cup"},
    ),
}
_STATIC = _Pair("capture0001", "capture0002", "Nothing changed; the camera moved by 11 cm and 1.3 degrees.")
_STATIC_POSE = Rotation.from_rotvec([0.002289, 0.019887, -0.010240]), np.array([-0.108695, 0.005716, 0.005465])
_SHA256 = {
    "learn6": "72810cd820a93dd1eec3d293159ab969266f7859309600d3e08f1e28b4293f26",
    "learn7": "d44143100d664abce427aef339d378e2fdc70eef5ed0c3164198ff2d59d27619",
    "learn9": "e7409070b35f2f6b7ae4058b19197e463936eead8fab357ba3a2eeef7a4558e6",
    "learn10": "612b333615178dbe301cebda601e5f0178d3e087d42bf7ba75adda80740f380e",
    "learn14": "32b152a90ae950b41a688eeea286d26374b6b0262b20c3111acd78ebc038d5e2",
    "learn15": "007ad2598fea95e9e17987615e0a5e2665fa7a9afdea3c25c03f07852941cc86",
    "learn37": "e811cea0f88b8ec54842ec7e6fc582d22e0d63cb72cc2402236343a599fb85c2",
    "learn38": "34e207c65d45b28f28af65f17a1ed71bd645d40be0ee498fa442a5a72d000ab7",
    "capture0001": "b3bf4f1ca7200e665c86e9ce28c142c7b058de64455713a36f555b0003f773de",
    "capture0002": "42e1c94ccd55e3c007c22736091d4151bf23c1f45b12b384a0168ad438a396fd",
}
_REMOTE = {"tabletop": "segmentation/mOSD/learn", "static": "tutorials/pairwise"}
TABLETOP_PAIRS = tuple(_PAIRS)


def tabletop_pair(name: str, data_dir: str | os.PathLike[str] | None = None) -> ScenePair:
    """Return a real before/after pair with the truth for every point, in metres, seen from the camera at the origin.

    The two files are looked for in `data_dir`/tabletop, $GMMCD_TEACH_DATA/tabletop and the download cache, in this
    order, and else fetched. Points are in the order of their pixels.

    Parameters
    ----------
    name : one of TABLETOP_PAIRS.
    data_dir : the folder that holds the folder tabletop.

    Raises
    ------
    ValueError
        There is no such pair.
    CloudError
        A file is damaged, or can be neither found nor fetched; the message says where to put it.

    Examples
    --------
    >>> if tabletop_available():
    ...     pair = tabletop_pair("bowl_removed_two_cups_added")
    ...     assert pair.object_names == ("bowl", "first cup", "second cup")
    """
    if name not in _PAIRS:
        raise ValueError(f"name is {name!r}; expected one of {', '.join(TABLETOP_PAIRS)}")
    return _load(name, _PAIRS[name], "tabletop", data_dir, np.eye(4))


def static_pair(data_dir: str | os.PathLike[str] | None = None) -> ScenePair:
    """Return two scans of an unchanged room, brought together: aligned, they must give no change.

    Both clouds are in the frame of the first camera. The pose of the second was found once, by point-to-plane ICP
    (median distance to the plane 3.5 mm at 2.2 m); the files come from data_dir/static as in `tabletop_pair`.

    Raises
    ------
    CloudError
        As `tabletop_pair`.

    Examples
    --------
    >>> if tabletop_available(folder="static"):
    ...     assert not static_pair().appeared.any()
    """
    pose = np.eye(4)
    rotation, pose[:3, 3] = _STATIC_POSE
    pose[:3, :3] = rotation.as_matrix()
    return _load("static_room", _STATIC, "static", data_dir, pose)


def tabletop_available(data_dir: str | os.PathLike[str] | None = None, folder: str = "tabletop") -> bool:
    """Tell whether every file of `folder` ("tabletop" or "static") is on this machine, so that nothing is fetched.

    Examples
    --------
    >>> tabletop_available("nowhere") in (True, False)
    True
    """
    pairs = {"tabletop": [*_PAIRS.values()], "static": [_STATIC]}
    if folder not in pairs:
        raise ValueError(f"folder is {folder!r}; expected one of {', '.join(pairs)}")
    stems = [stem for pair in pairs[folder] for stem in (pair.before, pair.after)]
    roots = [*_nearby(data_dir), _cache()]
    return all(any((root / folder / f"{stem}.pcd").is_file() for root in roots) for stem in stems)


def hidden_from(points: Floats, frame: DepthFrame, margin: float = NOISE) -> Bools:
    """Return which points `frame` could not have seen, (N,) bool.

    A point is hidden where the camera saw something nearer by more than `margin` (m) on the point's ray, or nothing
    at all, and where the point lies outside its image or behind it.

    Examples
    --------
    >>> frame = DepthFrame(np.full((3, 3), 2.0), np.eye(4), (1.0, 1.0, 1.0, 1.0))
    >>> hidden_from(np.array([[0, 0, 1.9], [0, 0, 2.1], [0, 0, -1], [9, 0, 1]]), frame)
    array([False,  True,  True,  True])
    """
    fx, fy, cx, cy = frame.intrinsics
    height, width = frame.depth.shape
    x, y, z = ((points - frame.pose[:3, 3]) @ frame.pose[:3, :3]).T  # world to camera
    ahead = z > 0
    reach = np.where(ahead, z, 1.0)
    u, v = np.rint(fx * x / reach + cx), np.rint(fy * y / reach + cy)
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    seen = np.full(len(points), np.nan)
    seen[inside] = frame.depth[v[inside].astype(int), u[inside].astype(int)]
    return ~(seen >= z - margin)


def _load(
    name: str, pair: _Pair, folder: str, data_dir: str | os.PathLike[str] | None, after_pose: Floats
) -> ScenePair:
    names = tuple(dict.fromkeys([*pair.removed.values(), *pair.added.values()]))
    before, before_labels, before_frame = _load_scan(pair.before, folder, data_dir, np.eye(4))
    after, after_labels, after_frame = _load_scan(pair.after, folder, data_dir, after_pose)
    before_objects = _number_objects(before_labels, pair.removed, names)
    after_objects = _number_objects(after_labels, pair.added, names)
    return ScenePair(
        name=name,
        description=pair.description,
        before=before,
        after=after,
        before_objects=before_objects,
        after_objects=after_objects,
        object_names=names,
        hidden_before=hidden_from(before, after_frame) & (before_objects == 0),
        hidden_after=hidden_from(after, before_frame) & (after_objects == 0),
        before_frames=(before_frame,),
        after_frames=(after_frame,),
    )


def _load_scan(
    stem: str, folder: str, data_dir: str | os.PathLike[str] | None, pose: Floats
) -> tuple[Floats, NDArray[np.int64], DepthFrame]:
    """Return the measured points (N, 3) in the world, their labels (N,) and the depth image of one organised file."""
    fields = read_fields(_find(stem, folder, data_dir))
    image = np.stack([fields[axis] for axis in "xyz"], axis=-1).astype(np.float64)  # (H, W, 3)
    measured = np.isfinite(image).all(axis=-1)
    depth = np.where(measured, image[..., 2], np.nan)
    labels = fields.get("label", np.zeros(measured.shape))[measured].astype(np.int64)
    return image[measured] @ pose[:3, :3].T + pose[:3, 3], labels, DepthFrame(depth, pose, INTRINSICS)


def _number_objects(labels: NDArray[np.int64], changed: dict[int, str], names: tuple[str, ...]) -> NDArray[np.int64]:
    """Return 1, 2, ... for points of the changed objects, 0 elsewhere; parts of object 40 are labelled 41, 42, ..."""
    objects = np.zeros_like(labels)
    for label, name in changed.items():
        objects[labels // 10 * 10 == label] = names.index(name) + 1
    return objects


def _nearby(data_dir: str | os.PathLike[str] | None) -> Iterator[Path]:
    for root in (data_dir, os.environ.get("GMMCD_TEACH_DATA")):
        if root:
            yield Path(root)


def _cache() -> Path:
    import pooch

    return Path(pooch.os_cache("gmmcd_teach"))


def _find(stem: str, folder: str, data_dir: str | os.PathLike[str] | None) -> Path:
    """Return a verified copy of a file, nearby or fetched."""
    for root in _nearby(data_dir):
        path = root / folder / f"{stem}.pcd"
        if path.is_file():
            try:
                digest = hashlib.sha256(path.read_bytes()).hexdigest()
            except OSError as error:
                raise CloudError(f"{path}: cannot be read ({error.strerror}); expected a readable file") from None
            if digest != _SHA256[stem]:
                raise CloudError(f"{path}: not the recorded file (its SHA-256 differs); delete it to fetch it again")
            return path
    return _fetch(stem, folder)


def _fetch(stem: str, folder: str) -> Path:
    """Return the copy in the download cache, fetched now if it is not there or damaged."""
    import pooch

    pooch.get_logger().setLevel("WARNING")  # its news of a download, on stderr, would fail a build of the book
    url = f"{SOURCE}/{_REMOTE[folder]}/{stem}.pcd"
    try:
        return Path(
            pooch.retrieve(
                url,
                known_hash=f"sha256:{_SHA256[stem]}",
                fname=f"{stem}.pcd",
                path=_cache() / folder,
                downloader=pooch.HTTPDownloader(timeout=30),
            )
        )
    except (OSError, ValueError) as error:  # no network and a full disk; another content than recorded
        raise CloudError(
            f"{stem}.pcd: not on this machine, and {url} cannot be fetched ({type(error).__name__}); "
            f"put the file in DIR/{folder} and set GMMCD_TEACH_DATA=DIR"
        ) from None
