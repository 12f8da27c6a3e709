"""Linear algebra of fits: steps within bounds, standard errors, and Jacobians that follow a step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

NORMAL_95 = 1.959964  # standard errors to either end of a 95 % interval
LEAST_EIGENVALUE = 1e-12  # over the largest, where each number alone has an information of 1: less is rounding
ROUNDING = 1e-9  # of the squared component of a unit vector


@dataclass(frozen=True)
class Known:
    """What an information matrix knows, in units in which each number alone has an information of 1.

    Parameters in mm, kV and shares differ so much that what tells small eigenvalues from rounding would take a
    parameter of little information for none at all.

    Attributes
    ----------
    units : ndarray, shape (numbers,)
        0 where nothing is known of one.
    values : ndarray, shape (directions,)
        Of the directions of which something is known.
    vectors : ndarray, shape (numbers, directions)
    """

    units: np.ndarray
    values: np.ndarray
    vectors: np.ndarray

    @classmethod
    def of(cls, information: np.ndarray) -> Known:
        """From an information matrix, shape (numbers, numbers)."""
        diagonal = np.diag(information)
        units = np.divide(1, np.sqrt(diagonal), out=np.zeros_like(diagonal), where=diagonal > 0)
        values, vectors = np.linalg.eigh(information * np.outer(units, units))
        seen = values > LEAST_EIGENVALUE * values.max(initial=0.0)
        return cls(units, values[seen], vectors[:, seen])

    @property
    def root(self) -> np.ndarray:
        """Of the covariance: root @ root.T, as far as anything is known; shape (numbers, directions)."""
        return self.vectors / np.sqrt(self.values) * self.units[:, None]

    @property
    def covariance(self) -> np.ndarray:
        """As far as anything is known, shape (numbers, numbers)."""
        root = self.root
        return root @ root.T


def standard_errors(information: np.ndarray) -> np.ndarray:
    """Standard errors of the numbers of a fit.

    Parameters
    ----------
    information : ndarray, shape (numbers, numbers)

    Returns
    -------
    ndarray, shape (numbers,)
        Infinite where a number, or what tells it from others, is not known at all.
    """
    known = Known.of(information)
    squares = known.vectors**2
    error = known.units * np.sqrt((squares / known.values).sum(axis=1))
    return np.where(squares.sum(axis=1) < 1 - ROUNDING, np.inf, error)


def interval(value: float, error: float, low: float = -np.inf, high: float = np.inf) -> list[float]:
    """95 % interval of a number with a standard error, as far as it may go.

    Parameters
    ----------
    low, high : float, optional
        The least and the largest value that the number may have.

    Returns
    -------
    list of 2 float
    """
    return [float(max(low, value - NORMAL_95 * error)), float(min(high, value + NORMAL_95 * error))]


def bounded_step(information, gradient, point, low, high) -> np.ndarray:
    """Newton step to the least of the quadratic model within the bounds.

    A free step that is cut to the bounds is none: of two numbers that trade against each other, cutting one leaves the
    other where it makes the fit worse.

    Parameters
    ----------
    information : ndarray, shape (numbers, numbers)
    gradient, point, low, high : ndarray, shape (numbers,)

    Returns
    -------
    ndarray, shape (numbers,)
    """
    known = Known.of(information)
    root, units = np.sqrt(known.values), known.units
    matrix, target = root[:, None] * known.vectors.T, known.vectors.T @ (gradient * units) / root
    moving = (units > 0) & (low < high)
    step = np.zeros(len(point))
    room = ((low - point)[moving] / units[moving], (high - point)[moving] / units[moving])
    step[moving] = units[moving] * lsq_linear(matrix[:, moving], target, room, method="bvls").x
    return step


def updated(jacobian, step, before, after) -> list[np.ndarray]:
    """Broyden's update [1]_: the least change of a Jacobian that agrees with a step just made.

    Derivatives by differences cost one prediction per parameter, this none.

    Parameters
    ----------
    jacobian : list of ndarray, shape (numbers, data)
        By part of the data.
    step : ndarray, shape (numbers,)
    before, after : list of ndarray, shape (data,)
        Residuals by part.

    Returns
    -------
    list of ndarray, shape (numbers, data)

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
