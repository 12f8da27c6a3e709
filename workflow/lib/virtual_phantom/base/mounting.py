"""Rotation of a detector about its reference point, relative to the nominal geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .vectors import ScanGeometry


@dataclass(frozen=True)
class Mounting:
    """Three successive rotations of a detector about its reference point; each uses the axes after the previous one.

    Attributes
    ----------
    roll_deg : float
        About the normal, from the column direction to the row direction, degrees.
    tilt_deg : float
        Then about the column direction; the last rows move towards the source, degrees.
    skew_deg : float
        Then about the row direction; the last columns move towards the source, degrees.
    """

    roll_deg: float = 0.0
    tilt_deg: float = 0.0
    skew_deg: float = 0.0

    @property
    def axes(self) -> np.ndarray:
        """Column direction, row direction and normal in nominal detector axes, shape (3, 3)."""
        roll, tilt, skew = ((math.cos(angle), math.sin(angle)) for angle in map(math.radians, self._turns))
        rolled = [[roll[0], roll[1], 0], [-roll[1], roll[0], 0], [0, 0, 1]]
        tilted = [[1, 0, 0], [0, tilt[0], -tilt[1]], [0, tilt[1], tilt[0]]]
        skewed = [[skew[0], 0, -skew[1]], [0, 1, 0], [skew[1], 0, skew[0]]]
        return np.array(skewed) @ tilted @ rolled

    @property
    def _turns(self) -> tuple[float, float, float]:
        return self.roll_deg, self.tilt_deg, self.skew_deg

    def of(self, geometry: ScanGeometry) -> ScanGeometry:
        """Return the scan with its detector rotated in every view, or the geometry itself without a rotation."""
        if not any(self._turns):
            return geometry
        stated = np.stack([geometry.column_direction, geometry.row_direction, geometry.normal], axis=1)
        columns, rows, _ = (self.axes @ stated).swapaxes(0, 1)
        return replace(geometry.by_vectors(), column_direction=columns, row_direction=rows)

    def solid_angles(self, geometry: ScanGeometry) -> np.ndarray:
        """Return solid angles of the rotated pixels relative to the nominal ones, shape (views or 1, rows, columns)."""
        plain = geometry.solid_angles()
        some = geometry if len(plain) > 1 else geometry.every(geometry.views)
        # Both are relative to a pixel at the foot of the perpendicular, which is closer to the rotated detector.
        return self.of(some).solid_angles() / plain / self.axes[2, 2] ** 2


AS_STATED = Mounting()
