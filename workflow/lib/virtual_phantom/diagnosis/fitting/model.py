"""Model of a recording for fits: unknowns, priors and predictions."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...base.lru_cache import LRUCache
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
from .linearization import BASE, Linearization, LinearizationPoint, before_images
from .nuisance import PLACE, PRIOR_BOUND_SD, Nuisance, pose_of
from .priors import Label, Statement
from .unknown import Unknown

DENSITY_SD = 0.02  # of the density scale where attenuation is absolute
TUBE_KVP_SD = 1.0  # kV: generators keep their voltage to about 1 %
CACHED_CHAINS = 8  # each linearized at one point
STARTS = (0.02, 0.1, 0.5)  # further starts, as shares of the range, for unknowns that may have local minima


class Model(ABC):
    """Predictions for effects' parameters and nuisance parameters, for any kind of recording.

    Parameters
    ----------
    chain : Chain
        Its detector's sensor gives the prior of the sensor thickness.
    tube_kvp : float, optional
        Nominal tube voltage, kV, with a standard deviation of TUBE_KVP_SD.
    density : tuple of 2 float, optional
        Density of the material relative to the listed one, and its standard deviation. It is the prior of the scale if
        an effect determines attenuation absolutely.
    declared : mapping of str to mapping of str to Statement, optional
        Known physics of the scanner, which is part of every model and fitted within its priors.
    object_errors : projections.object_errors.ObjectErrors
        Errors of the stated object, or none. They are nuisance parameters, too.
    first : Fit, optional
        Fit without effects, from which other fits begin; None: they begin at expected values.

    Attributes
    ----------
    fixed : mapping of str to mapping of str to float
        Parameters taken from elsewhere and not fitted: {effect: {parameter: value}}.
    """

    def __init__(
        self,
        chain: Chain,
        nuisances: tuple[Nuisance, ...],
        anode: Anode = TUNGSTEN,
        tube_kvp: float | None = None,
        density: tuple[float, float] = (1.0, DENSITY_SD),
        declared: Mapping[str, Mapping[str, Statement]] | None = None,
        *,
        object_errors: Any,
        first: Any = None,
    ):
        numbers = (*object_errors.edge_numbers, *object_errors.numbers)
        self.chain, self.base_nuisances, self.anode, self.tube_kvp = chain, (*nuisances, *numbers), anode, tube_kvp
        self.object_errors, self.first = object_errors, first
        self.fixed: Mapping[str, Mapping[str, float]] = {}
        self.density, self.declared = density, declared or {}
        self._chains = LRUCache(CACHED_CHAINS)

    def nuisances_for(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """Return the nuisance parameters of a model with these effects.

        The scale of line integrals is the density of the object if an effect determines attenuation absolutely.
        Otherwise it also includes the error of the assumed energy.
        """
        if not absolute_attenuation(self.with_declared_effects(effects)):
            return self.base_nuisances
        value, sd = self.density
        return tuple(
            replace(number, expected=value, sd=min(number.sd, sd)) if number.name == "scale" else number
            for number in self.base_nuisances
        )

    def with_declared_effects(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """Return the declared effects followed by these."""
        return (*(name for name in self.declared if name not in effects), *effects)

    def with_fixed(self, fixed: Mapping[str, Mapping[str, float]], density: tuple[float, float] | None = None) -> Model:
        """Return the model with parameters that are not fitted, and with another density unless it is None."""
        found = copy.copy(self)
        found.fixed, found.density = fixed, density or self.density
        return found

    def undeclared(self, name: str) -> Model:
        """Return the model without the declaration of one effect."""
        found = copy.copy(self)
        found.declared = {key: stated for key, stated in self.declared.items() if key != name}
        found.first = None
        return found

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Return an effect's parameters with their ranges in the recorded scan."""
        return self.chain.parameters(name)

    def known(self, name: str) -> dict[str, float]:
        """Return the parameters of an effect that are not fitted."""
        exact = {key: stated.value for key, stated in self.declared.get(name, {}).items() if not stated.sd}
        return self.chain.fixed_parameters(name) | dict(self.fixed.get(name, {})) | exact

    def in_study_units(self, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> dict:
        """Return settings of effects in units of a study, whose readout units are photons.

        Parameters
        ----------
        nuisance : mapping of str to float
            Includes `log_photons`, the logarithm of the photons per pixel in air.
        """
        photons = float(np.exp(nuisance["log_photons"]))
        state = self.chain.state(
            before_images(physics),  # a pattern of pixels changes no unit
            photons=photons,
            anode=self.anode,
        )
        every = (parameter for name in physics for parameter in load(name).parameters)
        counted = {parameter.name for parameter in every if READOUT_UNITS in parameter.unit}
        return {
            name: {key: value * photons / state.unit if key in counted else value for key, value in values.items()}
            for name, values in physics.items()
        }

    @property
    def nominal(self) -> Linearization:
        """Linearization before anything is fitted: BASE, or the object at its expected position."""
        place = {number.name: number.expected for number in self.base_nuisances if number.name in PLACE}
        if not any(place.values()):
            return BASE
        return Linearization(LinearizationPoint({}, place), LinearizationPoint({}, place))

    @property
    def labels(self) -> dict[str, Label]:
        """Priors of parameters that the scanner's label states (Parameter.nominal)."""
        low, high = KVP[self.anode.target]
        tube, sensor = Label("", low=low, high=high), self.chain.sensor
        if self.tube_kvp is not None:
            words = f"stated: {self.tube_kvp:g} ± {TUBE_KVP_SD:g}"
            tube = Label(words, self.tube_kvp, TUBE_KVP_SD, low, high)
        words = f"stated: {sensor.thickness_mm:g} ± {100 * sensor.thickness_sd:g} %"
        known = sensor.thickness_sd <= STATED_SD
        thickness = Label(words if known else "", sensor.thickness_mm, sensor.thickness_sd)
        return {TUBE_VOLTAGE: tube, SENSOR_THICKNESS: thickness}

    def unknowns(self, effects: tuple[str, ...]) -> list[Unknown]:
        """Return the unknowns of a fit, in order, without fixed parameters and parameters of a gain pattern."""
        return [
            unknown
            for name in effects
            for parameter in (() if load(name).pattern else self.parameters(name))
            if parameter.name not in self.fixed.get(name, {})
            and (unknown := self._unknown(name, parameter)) is not None
        ]

    def _unknown(self, name: str, parameter: Parameter) -> Unknown | None:
        """Return the unknown of a parameter, with range, starts and prior; None if it is declared exactly."""
        low, high = parameter.to_variable(parameter.low), parameter.to_variable(parameter.high)
        label = self.labels.get(parameter.nominal)
        if label is not None and label.low is not None:
            low, high = parameter.to_variable(label.low), parameter.to_variable(label.high)
        declared = self.declared.get(name, {}).get(parameter.name)
        if declared is not None:
            if not declared.sd:
                return None
            expected, sd = declared.variable_prior(parameter)
            return Unknown(name, parameter, low, high, (expected,), None, expected, sd)
        expected, sd = (low + high) / 2, high - low  # a wide prior, against runaways
        starts = (min(max(parameter.to_variable(parameter.start), low), high),)
        # Below the slice spacing, the slice thickness has no effect, so a fit that starts there would not change it.
        if parameter.neutral is None or (acts_on_images(name) and len(load(name).parameters) == 1):
            starts += tuple(low + share * (high - low) for share in STARTS)
        if label is not None and label.value is not None:
            expected, sd = parameter.to_variable(label.value), label.sd
            reach = PRIOR_BOUND_SD * sd
            low, high, starts = max(low, expected - reach), min(high, expected + reach), (expected,)
        neutral = None if parameter.neutral is None else parameter.to_variable(parameter.neutral)
        starts = tuple(dict.fromkeys(starts))
        return Unknown(name, parameter, low, high, starts, neutral, expected, sd)

    @property
    def distortions(self) -> tuple[str, ...]:
        """Names of the nuisance parameters that scale numerical errors."""
        return ()

    def distortion(self, nuisance: Mapping[str, float], linearization: Linearization = BASE) -> np.ndarray | float:
        """Return the correction of numerical errors that is added to the mean, broadcastable to it."""
        return sum(nuisance[name] * change for name, change in self.discretization_errors(linearization).items())

    def discretization_errors(self, linearization: Linearization = BASE) -> dict[str, np.ndarray]:
        """Return {nuisance parameter: change of the mean by finer discretization}; empty if there is none."""
        return {}

    def with_exact_object(self) -> Model:
        """Return the model without errors of the stated object."""
        found, names = copy.copy(self), self.object_errors.names
        found.object_errors = self.object_errors.of_edges()
        found.base_nuisances = tuple(number for number in self.base_nuisances if number.name not in names)
        return found

    @property
    def source_angles_rad(self) -> np.ndarray | None:
        """Direction of the source in every view, shape (views,); None for images."""
        return None

    def needs_relinearization(
        self, errors: LinearizationPoint, nuisance: Mapping[str, float], prediction: Prediction, weights: np.ndarray
    ) -> bool:
        """Return whether a prediction is too far from the point at which numerical errors were computed."""
        return False

    def in_linear_range(
        self, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float], rays: LinearizationPoint
    ) -> bool:
        """Return whether all rays of a prediction are in the linear range of a linearization point."""
        return self.linearized_at(rays).in_linear_range(before_images(physics), pose_of(nuisance), anode=self.anode)

    def linearized_at(self, rays: LinearizationPoint, reach: float = 1.0) -> Chain:
        """Return the chain that is linearized at a point."""
        return self._chains.get(
            (rays.key, reach),
            lambda: self.chain.linearized_at(rays.physics, pose_of(rays.nuisance), reach, anode=self.anode),
        )

    @abstractmethod
    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: Observed,
        linearization: Linearization = BASE,
    ) -> Prediction:
        """Return the prediction for settings of effects and nuisance parameters, without a gain pattern."""
