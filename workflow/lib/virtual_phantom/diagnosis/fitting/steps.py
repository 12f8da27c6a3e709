"""Linear algebra of fits: steps within bounds, standard errors, and Broyden's update of Jacobians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

NORMAL_95 = 1.959964  # standard errors to either end of a 95 % interval
LEAST_EIGENVALUE = 1e-12  # over the largest, in units in which each number alone has an information of 1: rounding
ROUNDING = 1e-9  # of the squared component of a unit vector


@dataclass(frozen=True)
class ScaledEigenvalues:
    """Eigenvalues of an information matrix whose rows and columns are scaled to a diagonal of 1.

    Parameters in mm, kV and shares differ by orders of magnitude. Without scaling, a threshold for rounding would
    discard parameters with little information.

    Attributes
    ----------
    units : ndarray, shape (numbers,)
        Scale factors: 1 / sqrt(diagonal), or 0 for a number without information.
    values : ndarray, shape (directions,)
        Eigenvalues above rounding.
    vectors : ndarray, shape (numbers, directions)
    """

    units: np.ndarray
    values: np.ndarray
    vectors: np.ndarray

    @classmethod
    def of(cls, information: np.ndarray) -> ScaledEigenvalues:
        """Decompose an information matrix, shape (numbers, numbers)."""
        diagonal = np.diag(information)
        units = np.divide(1, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0)
        values, vectors = np.linalg.eigh(information * np.outer(units, units))
        seen = values > LEAST_EIGENVALUE * values.max(initial=0.0)
        return cls(units, values[seen], vectors[:, seen])

    @property
    def root(self) -> np.ndarray:
        """Root of the covariance, root @ root.T, of the known directions; shape (numbers, directions)."""
        return self.vectors / np.sqrt(self.values) * self.units[:, None]

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the known directions, shape (numbers, numbers)."""
        root = self.root
        return root @ root.T


def standard_errors(information: np.ndarray) -> np.ndarray:
    """Return standard errors, shape (numbers,); infinite for a number that is not fully determined."""
    known = ScaledEigenvalues.of(information)
    squares = known.vectors**2
    error = known.units * np.sqrt((squares / known.values).sum(axis=1))
    return np.where(squares.sum(axis=1) < 1 - ROUNDING, np.inf, error)


def interval(value: float, error: float, low: float = -np.inf, high: float = np.inf) -> list[float]:
    """Return the 95 % interval of a number within its range."""
    return [float(max(low, value - NORMAL_95 * error)), float(min(high, value + NORMAL_95 * error))]


def bounded_step(information, gradient, point, low, high) -> np.ndarray:
    """Return the Newton step to the minimum of the quadratic model within bounds, shape (numbers,).

    Clipping an unbounded step would be wrong: if two numbers compensate each other and one is clipped, the other makes
    the fit worse.
    """
    known = ScaledEigenvalues.of(information)
    root, units = np.sqrt(known.values), known.units
    matrix, target = root[:, None] * known.vectors.T, known.vectors.T @ (gradient * units) / root
    moving = (units > 0) & (low < high)
    step = np.zeros(len(point))
    margins = ((low - point)[moving] / units[moving], (high - point)[moving] / units[moving])
    step[moving] = units[moving] * lsq_linear(matrix[:, moving], target, margins, method="bvls").x
    return step


def updated(jacobian, step, before, after) -> list[np.ndarray]:
    """Return a Jacobian after Broyden's update [1]_: the smallest change that agrees with a step.

    Parameters
    ----------
    jacobian : list of ndarray, shape (numbers, data)
        By part of the data.
    step : ndarray, shape (numbers,)
    before, after : list of ndarray, shape (data,)
        Residuals by part.

    References
    ----------
    .. [1] C. G. Broyden, Math. Comp. 19, 577, 1965.
    """
    size = float(step @ step)
    if not size:
        return jacobian
    return [
        rows + np.outer(step / size, old - new - step @ rows)
        for rows, old, new in zip(jacobian, before, after, strict=True)
    ]
