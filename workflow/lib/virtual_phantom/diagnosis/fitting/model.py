"""What fits ask a model for: its numbers, what is known of them, and what it predicts."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...base.recent import Kept
from ...physics.beam.spectra import KVP, TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.effect import READOUT_UNITS, Parameter, acts_on_images, load
from ..noise.condensed import Observed
from ..noise.prediction import Prediction
from .linearization import BASE, Linearisation, LinearisationPoint, before_images
from .nuisance import LOCATION, SURE, Nuisance, pose_of
from .priors import Statement
from .unknown import Unknown

DENSITY_SD = 0.02  # of the scale where a spectrum gives absolute attenuation: density of the material
TUBE_KVP_SD = 1.0  # kV: generators keep their voltage to about 1 %
NEAR_KEPT = 8  # chains whose rays follow those of a linearisation point
STARTS = (0.02, 0.1, 0.5)  # shares of a range where fits of a number may begin whose start may be no good


class Model(ABC):
    """Predictions of a recording for effects' parameters and the alignment.

    They are what fits ask for, whatever was recorded.

    Parameters
    ----------
    chain : Chain
        With the detector's sensor, whose thickness is held by what the chain knows of it.
    anode : Anode, optional
        Of the tube.
    tube_kvp : float, optional
        As the label on the scanner says, taken to be known to TUBE_KVP_SD, kV; None: not known.
    fixed : mapping of str to mapping of str to float, optional
        Parameters that are known from elsewhere and not fitted: {effect: {parameter: value}}.
    density : tuple of 2 float, optional
        Of the material over the listed one, and its standard deviation: the scale beside a spectrum.
    declared : mapping of str to mapping of str to Statement, optional
        Physics that is known of the scanner: in every model, fitted within what is stated.
    """

    def __init__(
        self,
        chain: Chain,
        aligned: tuple[Nuisance, ...],
        anode: Anode = TUNGSTEN,
        tube_kvp: float | None = None,
        fixed: Mapping[str, Mapping[str, float]] | None = None,
        density: tuple[float, float] = (1.0, DENSITY_SD),
        declared: Mapping[str, Mapping[str, Statement]] | None = None,
    ):
        self.chain, self.aligned, self.anode, self.tube_kvp = chain, aligned, anode, tube_kvp
        self.fixed, self.density, self.declared = fixed or {}, density, declared or {}
        self._near = Kept(NEAR_KEPT)

    def alignment(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """The alignment beside these effects.

        A spectrum leaves the scale only the density of the material: that of a monochromatic beam also holds the
        energy.
        """
        if "spectrum" not in self.whole(effects):
            return self.aligned
        value, sd = self.density
        return tuple(
            replace(one, expected=value, sd=min(one.sd, sd)) if one.name == "scale" else one for one in self.aligned
        )

    def whole(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """What is declared, and these effects."""
        return (*(name for name in self.declared if name not in effects), *effects)

    def undeclared(self, name: str) -> Model:
        """The same where one effect is not declared."""
        found = copy.copy(self)
        found.declared = {key: stated for key, stated in self.declared.items() if key != name}
        return found

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """An effect's parameters as the recorded scan shows them."""
        return self.chain.parameters(name)

    def known(self, name: str) -> dict[str, float]:
        """Parameters of an effect that are not fitted."""
        exact = {key: one.value for key, one in self.declared.get(name, {}).items() if not one.sd}
        return self.chain.held(name) | dict(self.fixed.get(name, {})) | exact

    def of_study(self, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> dict:
        """Settings of effects as a study takes them, whose readout units are photons.

        Parameters
        ----------
        physics : mapping of str to mapping of str to float
            {effect: {parameter: value}}.
        nuisance : mapping of str to float
            The alignment, whose photons per pixel they are.
        """
        photons = float(np.exp(nuisance["log_photons"]))
        state = self.chain.state(
            before_images(physics),  # a pattern of pixels changes no unit
            photons=photons,
            anode=self.anode,
        )
        counted = {one.name for name in physics for one in load(name).parameters if READOUT_UNITS in one.unit}
        return {
            name: {key: value * photons / state.unit if key in counted else value for key, value in values.items()}
            for name, values in physics.items()
        }

    @property
    def nominal(self) -> Linearisation:
        """Where predictions are linearised before anything is fitted: BASE, or the object where it is expected."""
        place = {one.name: one.expected for one in self.aligned if one.name in LOCATION}
        if not any(place.values()):
            return BASE
        return Linearisation(LinearisationPoint({}, place), LinearisationPoint({}, place))

    def unknowns(self, effects: tuple[str, ...]) -> list[Unknown]:
        """The effects' numbers that are fitted, in order: no fixed ones, and none of a gain pattern."""
        found = []
        for name in effects:
            effect, fixed = load(name), self.fixed.get(name, {})
            for one in () if effect.pattern else self.parameters(name):
                if one.name in fixed:
                    continue
                low, high = one.number(one.low), one.number(one.high)
                if (name, one.name) == ("spectrum", "kvp"):
                    low, high = KVP[self.anode.target]
                expected, sd = (low + high) / 2, high - low
                stated = self.declared.get(name, {}).get(one.name)
                if stated is not None:
                    if not stated.sd:
                        continue
                    expected, sd = stated.number(one)
                    found.append(Unknown(name, one.name, low, high, (expected,), None, expected, sd, one.power))
                    continue
                starts = (min(max(one.number(one.start), low), high),)
                # A slice thinner than their distance changes nothing, so that no fit would leave it.
                if one.neutral is None or (acts_on_images(name) and len(effect.parameters) == 1):
                    starts += tuple(low + share * (high - low) for share in STARTS)
                if (name, one.name) == ("spectrum", "kvp") and self.tube_kvp is not None:
                    expected, sd, starts = self.tube_kvp, TUBE_KVP_SD, (self.tube_kvp,)
                    low, high = max(low, expected - SURE * sd), min(high, expected + SURE * sd)
                if (name, one.name) == ("spectrum", "sensor_mm"):
                    expected, sd = one.number(self.chain.sensor.thickness_mm), self.chain.sensor.thickness_sd
                    low, high, starts = max(low, expected - SURE * sd), min(high, expected + SURE * sd), (expected,)
                neutral, starts = None if one.neutral is None else one.number(one.neutral), tuple(dict.fromkeys(starts))
                found.append(Unknown(name, one.name, low, high, starts, neutral, expected, sd, one.power))
        return found

    @property
    def distortions(self) -> tuple[str, ...]:
        """Names of the numerical errors among the numbers of the alignment."""
        return ()

    def distortion(self, nuisance: Mapping[str, float], linearisation: Linearisation = BASE) -> np.ndarray | float:
        """Numerical error that an alignment takes off what is predicted of the mean.

        Parameters
        ----------
        linearisation : Linearisation, optional
            Its `errors` is where the error is computed.

        Returns
        -------
        ndarray or float
            Broadcastable to the mean.
        """
        return 0.0

    def errors_of_steps(self, linearisation: Linearisation = BASE) -> dict[str, np.ndarray]:
        """What twice finer steps of the simulator change of the mean.

        Returns
        -------
        dict of str to ndarray
            {name of a number of the alignment: change per unit of it}; empty where there is none.
        """
        return {}

    @property
    def turned_rad(self) -> np.ndarray | None:
        """How far the source has turned in every view, shape (views,); None of images."""
        return None

    def strayed(
        self,
        errors: LinearisationPoint,
        nuisance: Mapping[str, float],
        prediction: Prediction,
        weights: np.ndarray,
    ) -> bool:
        """Whether a prediction lies too far off a point where `errors` of a linearisation were computed.

        Parameters
        ----------
        nuisance : mapping of str to float
            Of the prediction.
        weights : ndarray, shape (data,)
            Inverse variances of the mean.
        """
        return False

    def follows(
        self, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float], rays: LinearisationPoint
    ) -> bool:
        """Whether all rays of a prediction are near enough to those of a linearisation to follow them, or none can."""
        return self.near(rays).follows(before_images(physics), pose_of(nuisance), anode=self.anode)

    def near(self, rays: LinearisationPoint, reach: float = 1.0) -> Chain:
        """The chain whose rays follow those of a linearisation, as far as its reach."""
        return self._near.get(
            (rays.key, reach),
            lambda: self.chain.near(rays.physics, pose_of(rays.nuisance), reach, anode=self.anode),
        )

    @abstractmethod
    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: Observed,
        linearisation: Linearisation = BASE,
    ) -> Prediction:
        """The prediction for settings of effects and of the alignment.

        A gain pattern is fitted elsewhere: it has no mean of its own here.

        Parameters
        ----------
        physics : mapping of str to mapping of str to float
            {effect: {parameter: value}}.
        nuisance : mapping of str to float
            The alignment.
        """
