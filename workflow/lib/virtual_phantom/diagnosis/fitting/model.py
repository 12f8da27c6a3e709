"""What fits ask a model for: its numbers, what is known of them, and what it predicts."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...base.recent import Kept
from ...physics.beam.sensors import STATED_SD
from ...physics.beam.spectra import KVP, TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.effect import (
    READOUT_UNITS,
    SENSOR_THICKNESS,
    TUBE_VOLTAGE,
    Parameter,
    absolute_attenuation,
    acts_on_images,
    load,
)
from ..noise.condensed import Observed, Prediction
from .linearization import BASE, Linearisation, LinearisationPoint, before_images
from .nuisance import LOCATION, SURE, Nuisance, pose_of
from .priors import Label, Statement
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
        if not absolute_attenuation(self.whole(effects)):
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

    @property
    def labels(self) -> dict[str, Label]:
        """Priors of parameters that the scanner's label states (Parameter.nominal)."""
        low, high = KVP[self.anode.target]
        tube, sensor = Label("", low=low, high=high), self.chain.sensor
        if self.tube_kvp is not None:
            words = f"stated: {self.tube_kvp:g}, known within {TUBE_KVP_SD:g}"
            tube = Label(words, self.tube_kvp, TUBE_KVP_SD, low, high)
        words = f"stated: {sensor.thickness_mm:g}, known within {100 * sensor.thickness_sd:g} %"
        known = sensor.thickness_sd <= STATED_SD
        thickness = Label(words if known else "", sensor.thickness_mm, sensor.thickness_sd)
        return {TUBE_VOLTAGE: tube, SENSOR_THICKNESS: thickness}

    def unknowns(self, effects: tuple[str, ...]) -> list[Unknown]:
        """Return the numbers that fits vary, in order: neither fixed parameters nor those of a gain pattern."""
        return [
            unknown
            for name in effects
            for parameter in (() if load(name).pattern else self.parameters(name))
            if parameter.name not in self.fixed.get(name, {})
            and (unknown := self._unknown(name, parameter)) is not None
        ]

    def _unknown(self, name: str, parameter: Parameter) -> Unknown | None:
        """Return a parameter's number with its range, starts and prior; None if it is declared exactly."""
        low, high = parameter.number(parameter.low), parameter.number(parameter.high)
        label = self.labels.get(parameter.nominal)
        if label is not None and label.low is not None:
            low, high = parameter.number(label.low), parameter.number(label.high)
        declared = self.declared.get(name, {}).get(parameter.name)
        if declared is not None:
            expected, sd = declared.number(parameter)
            start = (expected,)
            return (
                Unknown(name, parameter.name, low, high, start, None, expected, sd, parameter.power)
                if declared.sd
                else None
            )
        expected, sd = (low + high) / 2, high - low  # a wide prior, against runaways
        starts = (min(max(parameter.number(parameter.start), low), high),)
        # A slice thinner than the distance of slices changes nothing, so that a fit would never leave it.
        if parameter.neutral is None or (acts_on_images(name) and len(load(name).parameters) == 1):
            starts += tuple(low + share * (high - low) for share in STARTS)
        if label is not None and label.value is not None:
            expected, sd = parameter.number(label.value), label.sd
            low, high, starts = max(low, expected - SURE * sd), min(high, expected + SURE * sd), (expected,)
        neutral = None if parameter.neutral is None else parameter.number(parameter.neutral)
        starts = tuple(dict.fromkeys(starts))
        return Unknown(name, parameter.name, low, high, starts, neutral, expected, sd, parameter.power)

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
