"""The Earth Mover's Distance: the least work that turns one distribution into another (chapter 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import ot
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from gmmcd_teach.clouds import CloudError, Floats
from gmmcd_teach.mixture import GaussianMixture, check_mixture, floats

MASSES = ("normalized", "partial")


@dataclass(frozen=True, eq=False)
class Transport:
    """An optimal way to move the mass.

    Attributes
    ----------
    distance : the work done divided by the total flow (Eq. 19), in the unit of the ground distance.
    flow : (K, L) mass moved from each source to each target.
    prices : (L,) what one unit more of each target's mass would cost: the dual variables of Eq. 18.
    """

    distance: float
    flow: Floats
    prices: Floats


def emd(
    weights_p: ArrayLike,
    weights_q: ArrayLike,
    ground_distance: ArrayLike,
    *,
    mass: str = "normalized",
    solver: str = "network-simplex",
) -> Transport:
    """Earth Mover's Distance between two weighted sets (Rubner, Tomasi & Guibas 2000; Eqs. 18 and 19).

    Parameters
    ----------
    weights_p, weights_q : (K,) and (L,) masses, not negative, of positive sum.
    ground_distance : (K, L) cost of moving one unit of mass, not negative.
    mass : "normalized" scales both sides to mass 1 first; "partial" leaves them and moves the smaller mass (Eq. 18 as
        printed: what is left over costs nothing, so it is no metric).
    solver : "network-simplex" (POT) or "linprog" (SciPy's general linear programming).

    Raises
    ------
    CloudError
        Masses or ground distances of the wrong shape, negative, not finite or without any mass.
    ValueError
        An unknown mass or solver.

    Examples
    --------
    >>> emd([0.5, 0.5], [1.0], [[1.0], [3.0]]).distance
    2.0
    >>> emd([0.5, 0.5], [0.5], [[1.0], [3.0]], mass="partial").distance
    1.0
    """
    if mass not in MASSES:
        raise ValueError(f"mass = {mass!r}; expected one of {', '.join(map(repr, MASSES))}")
    if solver not in SOLVERS:
        raise ValueError(f"solver = {solver!r}; expected one of {', '.join(map(repr, SOLVERS))}")
    p, q = _masses(weights_p, "weights_p"), _masses(weights_q, "weights_q")
    cost = floats(ground_distance, "ground_distance")
    if cost.shape != (len(p), len(q)) or not np.isfinite(cost).all() or cost.min() < 0:
        raise CloudError(f"ground_distance: shape {cost.shape}; expected ({len(p)}, {len(q)}), finite and not negative")
    if mass == "normalized":
        p, q = p / p.sum(), q / q.sum()
    flow, prices = _solve_with_slack(p, q, cost, SOLVERS[solver])
    if not flow.sum() > 0:
        raise CloudError(f"masses of {p.sum():.3g} and {q.sum():.3g}: too unequal for a solver; scale them alike")
    return Transport(float((flow * cost).sum() / flow.sum()), flow, prices)


def mean_distances(p: GaussianMixture, q: GaussianMixture) -> Floats:
    """(K, L) Euclidean distances between the means of mixtures p and q, metres: the paper's ground distance.

    Raises
    ------
    CloudError
        Not two mixtures of the same dimension.

    Examples
    --------
    >>> one = GaussianMixture([1.0], [[0.0, 0.0]], [np.eye(2)])
    >>> float(mean_distances(one, GaussianMixture([1.0], [[3.0, 4.0]], [np.eye(2)]))[0, 0])
    5.0
    """
    _same_dimensions(p, q)
    return np.linalg.norm(p.means[:, None] - q.means[None], axis=2)


def bures_distances(p: GaussianMixture, q: GaussianMixture) -> Floats:
    """(K, L) 2-Wasserstein distances between the Gaussians of mixtures p and q, metres.

    d^2 = |mu_p - mu_q|^2 + tr(A + B - 2 (A^1/2 B A^1/2)^1/2): position and shape (Dowson & Landau 1982).

    Raises
    ------
    CloudError
        Not two mixtures of the same dimension.

    Examples
    --------
    >>> narrow, wide = (GaussianMixture([1.0], [[0.0]], [[[v]]]) for v in (1.0, 9.0))
    >>> float(bures_distances(narrow, wide)[0, 0])
    2.0
    """
    _same_dimensions(p, q)
    values, vectors = np.linalg.eigh(p.covariances)
    lengths = np.sqrt(np.maximum(values, 0.0))  # (K, D)
    root = (vectors * lengths[:, None]) @ vectors.swapaxes(1, 2)  # (K, D, D) with root root = A
    inner = root[:, None] @ q.covariances[None] @ root[:, None]  # (K, L, D, D)
    overlap = np.sqrt(np.maximum(np.linalg.eigvalsh(inner), 0.0)).sum(axis=2)  # (K, L)
    spread = np.trace(p.covariances, axis1=1, axis2=2)[:, None] + np.trace(q.covariances, axis1=1, axis2=2)
    return np.sqrt(np.maximum(mean_distances(p, q) ** 2 + spread - 2 * overlap, 0.0))


GROUNDS: dict[str, Callable[[GaussianMixture, GaussianMixture], Floats]] = {
    "means": mean_distances,
    "bures": bures_distances,
}


def _solve_with_slack(
    p: Floats, q: Floats, cost: Floats, solver: Callable[..., tuple[Floats, Floats]]
) -> tuple[Floats, Floats]:
    """Flow (K, L) and prices (L,). The side with more mass sends the rest, free of charge, to a place of slack.

    The solvers get masses of sum 1 and costs of at most 1, since their tolerances are absolute.
    """
    n_p, n_q = cost.shape
    rest = p.sum() - q.sum()
    if rest > 1e-12 * p.sum():
        cost, q = np.column_stack([cost, np.zeros(n_p)]), np.append(q, rest)
    elif rest < -1e-12 * q.sum():
        cost, p = np.vstack([cost, np.zeros(n_q)]), np.append(p, -rest)
    unit = cost.max() or 1.0
    flow, potentials = solver(p / p.sum(), q / q.sum(), cost / unit)
    return p.sum() * flow[:n_p, :n_q], (cost - unit * potentials[:, None]).min(axis=0)[:n_q]


def _network_simplex(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats]:
    flow, log = ot.emd(p, q, cost, numItermax=1_000_000, log=True)
    if log["warning"] is not None:
        raise RuntimeError(f"the network simplex found no optimal flow: {log['warning']}")
    return flow, log["u"]


def _linear_programme(p: Floats, q: Floats, cost: Floats) -> tuple[Floats, Floats]:
    n_p, n_q = cost.shape
    sums = np.vstack([np.kron(np.eye(n_p), np.ones(n_q)), np.kron(np.ones(n_p), np.eye(n_q))])  # (K + L, K L)
    answer = linprog(cost.ravel(), A_eq=sums, b_eq=np.concatenate([p, q]), method="highs")
    if not answer.success or answer.x is None:
        raise RuntimeError(f"linprog found no optimal flow: {answer.message}")
    return answer.x.reshape(n_p, n_q), answer.eqlin.marginals[:n_p]


SOLVERS = {"network-simplex": _network_simplex, "linprog": _linear_programme}


def _masses(weights: ArrayLike, name: str) -> Floats:
    array = floats(weights, name)
    if array.ndim != 1 or not (array.min(initial=0.0) >= 0 and 0 < array.max(initial=0.0) < 1e150):
        raise CloudError(f"{name}: expected a (K,) array of masses from 0 to 1e150, not all of them 0")
    return array


def _same_dimensions(p: GaussianMixture, q: GaussianMixture) -> None:
    p, q = check_mixture(p, "p"), check_mixture(q, "q")
    if p.n_dimensions != q.n_dimensions:
        raise CloudError(f"mixtures of {p.n_dimensions} and {q.n_dimensions} dimensions; expected the same")
