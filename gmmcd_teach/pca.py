"""Principal component analysis: the directions in which a cloud spreads most (chapter 3)."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from gmmcd_teach.clouds import Floats, check_points


@dataclass(frozen=True, eq=False)
class PrincipalAxes:
    """Axes of a cloud, the widest first.

    Attributes
    ----------
    mean : (D,) centre of the cloud, metres.
    axes : (D, D) orthonormal rows, in order of falling variance; of each, the entry largest in size is positive.
    variances : (D,) square metres, with divisor N - 1.
    """

    mean: Floats
    axes: Floats
    variances: Floats

    def project(self, points: ArrayLike, n_components: int) -> Floats:
        """(N, n_components) coordinates along the first axes: the directions of least variance are dropped.

        Raises
        ------
        ValueError
            n_components is not between 1 and D.
        """
        if not isinstance(n_components, Integral) or not 1 <= n_components <= len(self.axes):
            raise ValueError(f"n_components = {n_components!r}; expected a whole number from 1 to {len(self.axes)}")
        return (check_points(points, dimensions=(len(self.mean),)) - self.mean) @ self.axes[:n_components].T

    def reconstruct(self, scores: ArrayLike) -> Floats:
        """(N, D) points back from their coordinates, exact when no axis was dropped."""
        scores = check_points(scores, "scores", dimensions=tuple(range(1, len(self.axes) + 1)))
        return self.mean + scores @ self.axes[: scores.shape[1]]


def principal_axes(points: ArrayLike) -> PrincipalAxes:
    """Principal axes as the eigenvectors of the covariance matrix (Bishop 2006, section 12.1).

    Parameters
    ----------
    points : (N, D) metres, N >= 2.

    Raises
    ------
    CloudError
        Fewer than two points, or not an array of finite numbers.

    Examples
    --------
    >>> flat = [[0, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0]]
    >>> principal_axes(flat).axes.round(6)[2]
    array([0., 0., 1.])
    """
    s = check_points(points, minimum=2)
    mean = s.mean(axis=0)
    centred = s - mean
    variances, columns = np.linalg.eigh(centred.T @ centred / (len(s) - 1))  # ascending
    axes = columns.T[::-1]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)  # (D, 1)
    return PrincipalAxes(mean, axes * np.where(largest < 0, -1.0, 1.0), np.maximum(variances[::-1], 0.0))
