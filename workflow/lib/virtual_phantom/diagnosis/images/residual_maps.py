"""Locations where recorded images and a model differ beyond noise."""

from __future__ import annotations

import numpy as np

from ...base.units import HU_BODY
from ..residuals.residual_tests import (
    DomainTest,
    HalfResiduals,
    blocks,
    by_value,
    extreme,
    holm_corrected,
    noise_tests,
    standardized,
    steepest,
)
from .observed import LAGS

AXES = ("slices", "rows", "columns")
RINGS = 16  # of equal width around the isocenter


def domain_tests(half: HalfResiduals, fitted: HalfResiduals | None = None, more=()) -> list[DomainTest]:
    """Test every domain of residuals of whitened voxels; arguments as in projections.residual_maps.domain_tests."""
    data, shape = half.data, half.data.mean.shape
    residual, weight = half.residuals[0].reshape(shape), half.weights[0].reshape(shape)

    def z(total) -> np.ndarray:
        return standardized(total(residual * weight), total(weight))

    expected = data.expected
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in shape[1:])
    ring = np.broadcast_to(np.hypot(rows[:, None], columns) * 2 * RINGS / max(shape[1:]), shape)
    ring = np.minimum(ring.astype(int), RINGS - 1)
    inside = (weight > 0) & (expected > HU_BODY)
    slope = np.hypot(*np.gradient(expected, axis=(1, 2)))
    found = [
        blocks("image", z(data.blocks.sum), data, AXES),
        extreme("slices", z(lambda values: values.sum(axis=(1, 2))), lambda i: f"slice {i} of {shape[0]}"),
        extreme(
            "distance from the axis",
            z(lambda values: np.bincount(ring.ravel(), values.ravel(), RINGS)),
            lambda i: f"ring {i + 1} of {RINGS}",
        ),
        by_value("tissue", "voxels of {:.0f} to {:.0f} HU", residual, weight, expected, inside),
        steepest("voxels", residual, weight, slope),
        *noise_tests(half, [_words(lag) for lag in LAGS], AXES, fitted),
    ]
    return holm_corrected([*found, *more])


def _words(lag: tuple[int, int, int]) -> str:
    axis = int(np.argmax(lag))
    return f"voxels {lag[axis]} {AXES[axis]} apart"
