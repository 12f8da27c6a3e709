"""What a model predicts of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prediction:
    """What a model predicts of the data, condensed as Observed has them.

    Attributes
    ----------
    mean : ndarray
        Along the data's three axes.
    log_variance : ndarray, shape (blocks,)
        Logarithm of the variance over Observed.reference.
    correlation : ndarray, shape (pairs,), or None
        None where the data have none.
    design : tuple of 2 ndarray
        Change of the mean with the alignment's scale and offset, shaped as it or broadcastable to it.
    """

    mean: np.ndarray
    log_variance: np.ndarray
    correlation: np.ndarray | None
    design: tuple[np.ndarray, np.ndarray]
