"""Detector gain pattern: rings."""

import numpy as np

from ...base.streams import Branch, branch, generator
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Set the gain of every pixel."""
    rows = np.arange(state.geometry.rows) * 2 - state.geometry.rows + 1  # from the middle, in half rows
    state.gain = np.exp(values["rms"] * np.stack([_row(int(values["detector"]), row, state) for row in rows]))


def _row(detector: int, row: int, state: State) -> np.ndarray:
    """Standard normal (columns,) of a row by its place.

    The pattern is the detector's own: the same in every scan of it, of whatever rows the collimator leaves.

    Returns
    -------
    ndarray, shape (columns,)
    """
    stream = branch(0, Branch.GAIN_PATTERN, detector, int(row < 0), abs(int(row)))
    return generator(stream).normal(size=state.geometry.columns)


EFFECT = Effect(
    name="gain_pattern",
    physics="Pixels' gains have drifted since the air scan: a constant in all views, a ring in the image.",
    equation="read(u, v) = g(u, v) S(u, v), ln g with standard deviation r",
    source="J. Sijbers and A. Postnov, Phys. Med. Biol. 49, N247 (2004)",
    stage="readout",
    signature="residuals constant over views, different from pixel to pixel",
    settled_by="a new air scan just before or after",
    parameters=(
        Parameter("rms", "1", "standard deviation of ln gain", 0.0, 0.2, 0.002, 0.005),
        Parameter("detector", "number", "which pattern is drawn", 0.0, 1e6, 0.0, 0.0, None),
    ),
    apply=apply,
    of_one_scan=True,
    removed_by=("gain", "flat"),
    pattern=True,
)
