"""What the chain predicts of projections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...physics.chain import Chain
from ...physics.correlation import correlations
from ...physics.spectra import TUNGSTEN, Anode
from ...physics.state import State
from ..core.alignment import Nuisance, pose_of
from ..core.linearisation import BASE, Linearisation, LinearisationPoint, before_images
from ..core.model import DENSITY_SD, Model
from ..core.prediction import Prediction
from ..core.statement import Statement
from .numerical import Numerical
from .observed import ObservedScans, white_shape


@dataclass(frozen=True)
class ScansPrediction(Prediction):
    """As ObservedScans.

    Attributes
    ----------
    white : ndarray or None
        Coefficients of the white field's shape.
    state : State
        Of the chain, of which all this is.
    """

    white: np.ndarray | None
    state: State


class ScansModel(Model):
    """Predictions of line integrals.

    Parameters
    ----------
    chain, aligned, anode, tube_kvp, fixed, density, declared
        As Model takes them.
    numerical : Numerical, optional
        Errors of its steps, each a distortion of the line integrals that is fitted within its bounds, since it is alike
        in many rays and no noise; None: there are none.
    """

    def __init__(
        self,
        chain: Chain,
        aligned: tuple[Nuisance, ...],
        anode: Anode = TUNGSTEN,
        tube_kvp: float | None = None,
        fixed: Mapping[str, Mapping[str, float]] | None = None,
        density: tuple[float, float] = (1.0, DENSITY_SD),
        numerical: Numerical | None = None,
        declared: Mapping[str, Mapping[str, Statement]] | None = None,
    ):
        super().__init__(chain, aligned, anode, tube_kvp, fixed, density, declared)
        self.numerical = numerical

    @property
    def distortions(self) -> tuple[str, ...]:
        """As Model.distortions."""
        return () if self.numerical is None else self.numerical.names

    def distortion(self, nuisance: Mapping[str, float], linearisation: Linearisation = BASE) -> np.ndarray | float:
        """As Model.distortion."""
        if self.numerical is None:
            return 0.0
        return sum(nuisance[name] * change for name, change in self.numerical.at(linearisation.errors).items())

    def strayed(
        self,
        errors: LinearisationPoint,
        nuisance: Mapping[str, float],
        prediction: ScansPrediction,
        weights: np.ndarray,
    ) -> bool:
        """As Model.strayed."""
        lines = prediction.design[0]
        return bool(self.distortions) and self.numerical.strayed(errors, lines, weights.reshape(lines.shape))

    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: ObservedScans,
        linearisation: Linearisation = BASE,
    ) -> ScansPrediction:
        """As Model.predict."""
        photons = float(np.exp(nuisance["log_photons"]))
        chain = self.near(linearisation.rays)
        state = chain.state(before_images(physics), pose_of(nuisance), photons=photons, anode=self.anode)
        # The logarithm of noisy counts lies above that of their mean.
        above, variance = state.log_noise()
        lines = state.line_integrals()
        mean = nuisance["scale"] * lines + nuisance["offset"] + self.distortion(nuisance, linearisation) + above
        ratio = np.where(data.usable, variance / data.reference, 0)
        correlation = correlations(state, np.where(data.usable, 1 / data.reference, 0))
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(data.blocks.sum(ratio) / data.blocks.sum(data.usable))
        white = None if data.white is None else white_shape(state.measured_air[0])
        return ScansPrediction(mean, log_variance, correlation, (lines, np.ones(lines.shape)), white, state)
