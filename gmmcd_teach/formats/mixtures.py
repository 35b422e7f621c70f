"""Mixtures in .npz files: three plain arrays, checked again when they come back."""

from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gmmcd_teach.clouds import CloudError
from gmmcd_teach.formats import Malformed
from gmmcd_teach.formats.arrays import read_members
from gmmcd_teach.formats.atomic import write_atomically
from gmmcd_teach.mixture import GaussianMixture


def write_mixture(path: str | os.PathLike[str], mixture: GaussianMixture) -> None:
    """Write weights, means and covariances to a .npz; the file appears complete or not at all.

    Raises
    ------
    CloudError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_mixture(f"{folder}/one.npz", GaussianMixture([1.0], [[2.0]], [[[3.0]]]))
    ...     read_mixture(f"{folder}/one.npz").means
    array([[2.]])
    """

    def write(file: BinaryIO) -> None:
        np.savez(file, weights=mixture.weights, means=mixture.means, covariances=mixture.covariances)

    try:
        write_atomically(Path(path), write)
    except OSError as error:
        raise CloudError(f"{path}: cannot be written ({error.strerror}); expected a writable folder") from None


def read_mixture(path: str | os.PathLike[str]) -> GaussianMixture:
    """Read a mixture from a .npz; nothing in the file is run, and the mixture is validated.

    Raises
    ------
    CloudError
        The file is missing, is no .npz of weights, means and covariances, or they make no mixture.

    Examples
    --------
    >>> read_mixture("nowhere.npz")
    Traceback (most recent call last):
    gmmcd_teach.clouds.CloudError: nowhere.npz: cannot be read (No such file or directory); expected a mixture's .npz
    """
    try:
        arrays = read_members(Path(path).read_bytes())
    except OSError as error:
        raise CloudError(f"{path}: cannot be read ({error.strerror}); expected a mixture's .npz") from None
    except Malformed as problem:
        raise CloudError(f"{path}: {problem}") from None
    if missing := {"weights", "means", "covariances"} - set(arrays):
        raise CloudError(f"{path}: no {', '.join(sorted(missing))}; expected weights, means and covariances")
    return GaussianMixture(arrays["weights"], arrays["means"], arrays["covariances"])
