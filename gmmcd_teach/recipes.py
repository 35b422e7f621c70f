"""Clouds to and from other libraries, in a few lines each (chapter 18); each library is imported when asked for."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmmcd_teach.clouds import CloudError, Floats, check_points
from gmmcd_teach.formats import as_rows

ROS_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # sensor_msgs/PointField


def to_open3d(points: ArrayLike) -> Any:
    """Points (N, 3) as an open3d.geometry.PointCloud."""
    import open3d  # type: ignore[import-not-found,unused-ignore]

    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(check_points(points, dimensions=(3,))))


def from_open3d(cloud: Any) -> Floats:
    """Points (N, 3) of an open3d.geometry.PointCloud, those that are not finite left out."""
    return finite(np.asarray(cloud.points))


def to_pyvista(points: ArrayLike, **per_point: ArrayLike) -> Any:
    """Points (N, 3) and columns of N values as a pyvista.PolyData.

    Examples
    --------
    >>> cloud = to_pyvista([[0, 0, 1], [1, 2, 3]], appeared=[False, True])
    >>> from_pyvista(cloud)
    array([[0., 0., 1.],
           [1., 2., 3.]])
    >>> np.asarray(cloud["appeared"])
    array([False,  True])
    """
    import pyvista

    cloud = pyvista.PolyData(check_points(points, dimensions=(3,)))
    for name, values in per_point.items():
        cloud.point_data[name] = np.asarray(values)
    return cloud


def from_pyvista(cloud: Any) -> Floats:
    """Points (N, 3) of any pyvista mesh, those that are not finite left out."""
    return finite(np.asarray(cloud.points))


def from_pointcloud2(message: Any) -> dict[str, NDArray[Any]]:
    """Columns of a ROS sensor_msgs/PointCloud2 message by name, each (N,), or (N, k) where a field has k numbers.

    It needs neither ROS nor a copy of its classes: any object with the message's fields will do, as those that the
    package rosbags reads from a bag.

    Examples
    --------
    >>> message = to_pointcloud2([[0, 0, 1], [1, 2, 3]], label=np.array([0, 7], dtype=np.uint8))
    >>> columns = from_pointcloud2(message)
    >>> points_of(columns)
    array([[0., 0., 1.],
           [1., 2., 3.]])
    >>> columns["label"]
    array([0, 7], dtype=uint8)
    """
    order = ">" if message.is_bigendian else "<"
    row = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": [(f"{order}{ROS_TYPES[field.datatype]}", (field.count,)) for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    data = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, message.row_step)
    rows = np.ascontiguousarray(data[:, : message.width * message.point_step]).view(row).ravel()  # padding is cut off
    columns = {name: rows[name].astype(row[name].base.newbyteorder("=")) for name in row.names or ()}
    return {name: column[:, 0] if column.shape[1] == 1 else column for name, column in columns.items()}


def to_pointcloud2(points: ArrayLike, **per_point: ArrayLike) -> SimpleNamespace:
    """Points (N, 3) and columns of N numbers as an object with the fields of a PointCloud2; x, y, z become float32.

    Copy its fields into the message of your ROS, and give that a header.

    Raises
    ------
    CloudError
        A column is not N numbers of a type that the message knows: integers have at most 32 bits.

    Examples
    --------
    >>> to_pointcloud2([[0, 0, 1]], appeared=[True]).point_step
    13
    """
    s = check_points(points, dimensions=(3,)).astype(np.float32)
    columns = dict(zip("xyz", s.T, strict=True))
    for name, values in per_point.items():
        column = np.asarray(values)
        columns[name] = column.astype(np.uint8) if column.dtype == bool else column
        if columns[name].dtype.str[1:] not in ROS_TYPES.values() or column.shape != (len(s),):
            shape = f"{column.dtype} of shape {column.shape}"
            raise CloudError(f"column {name!r}: {shape}; expected {len(s)} numbers of {' '.join(ROS_TYPES.values())}")
    rows = as_rows(columns)  # (N,) of x, y, z, ... side by side, little-endian, without gaps
    numbers = {name: number for number, name in ROS_TYPES.items()}
    offsets = np.cumsum([0, *(column.dtype.itemsize for column in columns.values())]).tolist()
    fields = [
        SimpleNamespace(name=name, offset=offset, datatype=numbers[column.dtype.str[1:]], count=1)
        for offset, (name, column) in zip(offsets, columns.items(), strict=False)
    ]
    step = rows.dtype.itemsize
    data = np.frombuffer(rows.tobytes(), np.uint8)
    size = {"height": 1, "width": len(s), "point_step": step, "row_step": step * len(s)}
    return SimpleNamespace(fields=fields, is_bigendian=False, data=data, is_dense=True, **size)


def points_of(columns: dict[str, NDArray[Any]]) -> Floats:
    """Points (N, 3) from columns x, y, z, those that are not finite left out."""
    return finite(np.stack([columns[axis] for axis in "xyz"], axis=1))


def finite(points: ArrayLike) -> Floats:
    """Points (N, 3) as float64, those that are not finite left out: what every function here wants.

    Examples
    --------
    >>> finite([[1, 2, 3], [np.nan, 0, 0]])
    array([[1., 2., 3.]])
    """
    array = np.array(points, dtype=np.float64)
    return array[np.isfinite(array).all(axis=1)]
