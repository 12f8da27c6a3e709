"""Model of projections: predictions of the simulation chain."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...physics.chain import Chain
from ...physics.noise.correlation import correlations
from ...physics.scenes.inclusion import Inclusion
from ...physics.state import State
from ..fitting.linearization import BASE, Linearization, LinearizationPoint, before_images
from ..fitting.model import Model
from ..fitting.nuisance import Nuisance, pose_of
from ..noise.condensed import Prediction
from .discretization import Numerical, inclusions_of
from .local_mismatch import Piece
from .object_errors import ObjectErrors
from .observed import ObservedScans, white_shape


@dataclass(frozen=True)
class ScansPrediction(Prediction):
    """Prediction of ObservedScans.

    Attributes
    ----------
    white : ndarray or None
        Coefficients of the white field's shape.
    """

    white: np.ndarray | None
    state: State


class ScansModel(Model):
    """Predictions of line integrals.

    Parameters
    ----------
    chain, nuisances, **settings
        See Model.
    numerical : Numerical, optional
        Discretization errors. Each is fitted as a distortion of the line integrals, because it is systematic.

    Attributes
    ----------
    pieces : mapping of str to Inclusion
        {nuisance parameter: piece of the object, whose excess attenuation in 1/mm is this parameter}.
    """

    def __init__(
        self,
        chain: Chain,
        nuisances: tuple[Nuisance, ...],
        *,
        numerical: Numerical | None = None,
        object_errors: ObjectErrors | None = None,
        **settings,
    ):
        super().__init__(chain, nuisances, object_errors=object_errors or ObjectErrors(), **settings)
        self.numerical = numerical or Numerical(chain, None, None)
        self.pieces: Mapping[str, Inclusion] = {}

    def with_piece(self, number: Nuisance, piece: Piece) -> ScansModel:
        """Return the model with one more piece of the object, whose excess attenuation is the nuisance parameter."""
        found = copy.copy(self)
        found.base_nuisances = (*self.base_nuisances, number)
        found.pieces = {**self.pieces, number.name: Inclusion(piece.shape, piece)}
        found.numerical = self.numerical.with_pieces(found.pieces)
        return found

    @property
    def distortions(self) -> tuple[str, ...]:
        """See Model.distortions."""
        return (*self.numerical.names, *(number.name for number in self.object_errors.edge_numbers))

    def discretization_errors(self, linearization: Linearization = BASE) -> dict[str, np.ndarray]:
        """See Model.discretization_errors."""
        edges, numerical = self.object_errors.edges, self.numerical.at(linearization.errors)
        return numerical | ({} if edges is None else edges.at(pose_of(linearization.errors.nuisance)))

    @property
    def source_angles_rad(self) -> np.ndarray:
        """See Model.source_angles_rad."""
        source = self.chain.geometry.by_vectors().source_mm
        return np.arctan2(source[:, 1], source[:, 0])

    def needs_relinearization(
        self, errors: LinearizationPoint, nuisance, prediction: ScansPrediction, weights: np.ndarray
    ) -> bool:
        """See Model.needs_relinearization."""
        lines = prediction.design[0]
        return bool(self.numerical.names) and self.numerical.needs_relinearization(
            errors, lines, weights.reshape(lines.shape)
        )

    def predict(self, physics, nuisance, data: ObservedScans, linearization: Linearization = BASE) -> ScansPrediction:
        """See Model.predict."""
        photons = float(np.exp(nuisance["log_photons"]))
        chain = self.linearized_at(linearization.rays, linearization.reach)
        physics, pose = before_images(physics), pose_of(nuisance)
        state = chain.state(
            physics, pose, photons=photons, anode=self.anode, added=inclusions_of(self.pieces, nuisance)
        )
        # Noise increases mean line integrals, because the mean logarithm is below the logarithm of the mean.
        above, variance = state.log_noise()
        lines = state.line_integrals()
        mean = nuisance["scale"] * lines + nuisance["offset"] + self.distortion(nuisance, linearization) + above
        if self.object_errors.numbers:
            mean += self.object_errors.lines(nuisance)
        ratio = np.where(data.usable, variance / data.reference, 0)
        correlation = data.correlation  # None for a single repeat
        if correlation is not None and np.isfinite(correlation).any():
            correlation = correlations(state, np.where(data.usable, 1 / data.reference, 0))
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(data.noise_blocks.sum(ratio) / data.noise_blocks.sum(data.usable))
        white = None if data.white is None else white_shape(state.measured_air[0])
        return ScansPrediction(mean, log_variance, correlation, (lines, np.ones(lines.shape)), white, state)
