"""Detector gain pattern, which causes rings."""

import numpy as np

from ...base.streams import Branch, branch, generator
from ..effect import Effect, Parameter
from ..state import State


def apply(state: State, values: dict[str, float]) -> None:
    """Multiply the gain of every pixel."""
    rows = np.arange(state.geometry.rows) * 2 - state.geometry.rows + 1  # position from the center, in half rows
    gain = np.exp(values["rms"] * np.stack([_row(int(values["detector"]), row, state) for row in rows]))
    state.gain = gain if state.gain is None else state.gain * gain


def _row(detector: int, row: int, state: State) -> np.ndarray:
    """Draw standard normal values for a row from its position.

    The pattern belongs to the detector, so it is the same in every scan, whichever rows are collimated.

    Returns
    -------
    ndarray, shape (columns,)
    """
    stream = branch(0, Branch.GAIN_PATTERN, detector, int(row < 0), abs(int(row)))
    return generator(stream).normal(size=state.geometry.columns)


EFFECT = Effect(
    name="gain_pattern",
    physics="Pixel gains have drifted since the air scan. Each error is constant over views and makes a ring in the "
    "image.",
    equation="read(u, v) = g(u, v) S(u, v), ln g normal with standard deviation r",
    source="J. Sijbers and A. Postnov, Phys. Med. Biol. 49, N247 (2004)",
    stage="readout",
    signature="residuals that are constant over views and differ between pixels",
    settled_by="make an air scan immediately before or after the scan",
    parameters=(
        Parameter("rms", "1", "r: standard deviation of ln gain from pixel to pixel", 0.0, 0.2, 0.002, 0.005),
        Parameter("detector", "number", "number of the random pattern", 0.0, 1e6, 0.0, 0.0, None),
    ),
    apply=apply,
    of_one_scan=True,
    removed_by=("gain", "flat"),
    pattern=True,
)
