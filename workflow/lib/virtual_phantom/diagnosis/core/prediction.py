"""What a model predicts of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prediction:
    """As Observed: mean, log_variance (block,) over its reference, correlation.

    design   change of the mean with the alignment's scale and offset, the same shape (or broadcast to it)
    """

    mean: np.ndarray
    log_variance: np.ndarray
    correlation: np.ndarray
    design: tuple[np.ndarray, np.ndarray]
