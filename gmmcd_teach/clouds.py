"""Point clouds: arrays of shape (N, D) in metres, read, written and checked (chapter 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class CloudError(ValueError):
    """A cloud that cannot be used: names the file or argument, what is wrong and what would be right."""


def check_points(points: ArrayLike, name: str = "points", *, minimum: int = 1, dimensions: tuple[int, ...] = ()) -> Floats:
    """Return `points` as a float64 array of shape (N, D), or say in one line why that cannot be done.

    Parameters
    ----------
    points : array-like (N, D), metres.
    name : what the message calls the array.
    minimum : fewest points allowed.
    dimensions : the D allowed; empty for any D >= 1.

    Raises
    ------
    CloudError
        The array is not numeric, not (N, D), too short, or holds NaN or infinity.

    Examples
    --------
    >>> check_points([[0, 0, 1], [1, 2, 3]]).shape
    (2, 3)
    """
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise CloudError(f"{name}: not an array of numbers; expected shape (N, D) in metres") from None
    wanted = " or ".join(str(d) for d in dimensions) or "1 or more"
    if array.ndim != 2 or array.shape[1] == 0 or (dimensions and array.shape[1] not in dimensions):
        raise CloudError(f"{name}: shape {array.shape}; expected (N, D) with D = {wanted}")
    if len(array) < minimum:
        raise CloudError(f"{name}: {len(array)} points; at least {minimum} needed")
    bad = np.count_nonzero(~np.isfinite(array).all(axis=1))
    if bad:
        raise CloudError(f"{name}: {bad} of {len(array)} points hold NaN or infinity; drop them first")
    return array
