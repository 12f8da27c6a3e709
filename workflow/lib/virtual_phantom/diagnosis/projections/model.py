"""What the chain predicts of a recording, with the alignment that every model gets alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...physics.chain import Chain, State
from ...physics.correlation import correlations
from ...physics.effect import LOGARITHM, READOUT_UNITS, Parameter, acts_on_images, load
from ...physics.spectra import KVP, TUNGSTEN, Anode
from ..core.alignment import SURE, Nuisance, pose_of
from ..core.steps import NORMAL_95
from .numerical import BASE, LinearisationPoint, Numerical
from .observed import WHITE_TOLERANCE, Observed, white_shape

DENSITY_SD = 0.02  # of the scale where a spectrum gives absolute attenuation: density of the material
TUBE_KVP_SD = 1.0  # kV: generators keep their voltage to about 1 %
STARTS = (0.02, 0.1, 0.5)  # shares of a range where fits of a number may begin whose start may be no good


@dataclass(frozen=True)
class Unknown:
    """A number of an effect, as fits vary it: a parameter to its power, or its logarithm. Its plausible range, where
    a fit may begin, the one that changes nothing, if there is one, and the Gaussian that it is held by.

    Without further knowledge that is as wide as the range: against runaways.
    """

    effect: str
    name: str
    low: float
    high: float
    starts: tuple[float, ...]
    neutral: float | None
    expected: float
    sd: float
    power: int = 1

    def of(self, value: float) -> float:
        """The number of a parameter's value."""
        return math.log(value) if self.power == LOGARITHM else value**self.power

    def value(self, number: float) -> float:
        """The parameter's value."""
        return math.exp(number) if self.power == LOGARITHM else number ** (1 / self.power)

    def value_error(self, number: float, error: float) -> float:
        """Of the value, from that of the number: so that the 95 % interval reaches at least as far."""
        if self.power == 1 or not np.isfinite(error):
            return error
        if self.power == LOGARITHM:
            error = min(error, self.high - self.low)  # farther than the whole range, and beyond numbers
            ends = [self.value(number + side * NORMAL_95 * error) for side in (-1, 1)]
        else:
            ends = [self.value(max(0.0, number + side * NORMAL_95 * error)) for side in (-1, 1)]
        return max(abs(end - self.value(number)) for end in ends) / NORMAL_95

    @property
    def start(self) -> float:
        return self.starts[0]


@dataclass(frozen=True)
class Prediction:
    """As Observed: mean [view, row, column], log_variance (block,) over its reference, correlation, white.

    design   change of the mean with the alignment's scale and offset, the same shape (or broadcast to it)
    """

    mean: np.ndarray
    log_variance: np.ndarray
    correlation: np.ndarray
    white: np.ndarray | None
    state: State
    design: tuple[np.ndarray, np.ndarray]


class Model:
    """Predictions for effects' parameters and the alignment.

    chain      with the detector's sensor, whose thickness is held by what the chain knows of it
    anode      of the tube
    tube_kvp   as the label on the scanner says, taken to be known to TUBE_KVP_SD; None: not known
    fixed      effects whose parameters are known from elsewhere and not fitted
    density    of the material over the listed one, and its standard deviation: the scale beside a spectrum
    numerical  errors of its steps, each a distortion of the line integrals that is fitted within its bounds, since it
               is alike in many rays and no noise; None: there are none
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
    ):
        self.chain, self.aligned, self.anode, self.tube_kvp = chain, aligned, anode, tube_kvp
        self.fixed, self.density, self.numerical = fixed or {}, density, numerical

    def alignment(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """The alignment beside these effects. A spectrum leaves the scale only the density of the material: that of a
        monochromatic beam also holds the energy."""
        if "spectrum" not in effects:
            return self.aligned
        value, sd = self.density
        return tuple(
            replace(one, expected=value, sd=min(one.sd, sd)) if one.name == "scale" else one for one in self.aligned
        )

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """An effect's parameters as the recorded scan shows them."""
        return self.chain.parameters(name)

    def known(self, name: str) -> dict[str, float]:
        """Parameters of an effect that are not fitted."""
        return self.chain.held(name) | dict(self.fixed.get(name, {}))

    def of_study(self, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> dict:
        """Settings of effects as a study takes them, whose readout units are photons.

        nuisance  the alignment, whose photons per pixel they are
        """
        photons = float(np.exp(nuisance["log_photons"]))
        state = self.chain.state(
            # A pattern of pixels changes no unit, and which one it is nobody knows.
            {name: values for name, values in physics.items() if not (acts_on_images(name) or load(name).pattern)},
            photons=photons,
            anode=self.anode,
        )
        counted = {one.name for name in physics for one in load(name).parameters if READOUT_UNITS in one.unit}
        return {
            name: {key: value * photons / state.unit if key in counted else value for key, value in values.items()}
            for name, values in physics.items()
        }

    def unknowns(self, effects: tuple[str, ...]) -> list[Unknown]:
        """The effects' numbers that are fitted, in order. Of a gain pattern and of fixed effects there are none."""
        found = []
        for name in effects:
            effect = load(name)
            for one in () if effect.pattern or name in self.fixed else self.parameters(name):
                low, high = one.number(one.low), one.number(one.high)
                if (name, one.name) == ("spectrum", "kvp"):
                    low, high = KVP[self.anode.target]
                expected, sd = (low + high) / 2, high - low
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
        return () if self.numerical is None else self.numerical.names

    def distortion(self, nuisance: Mapping[str, float], linearisation: LinearisationPoint = BASE) -> np.ndarray | float:
        """Numerical error that an alignment takes off the line integrals.

        linearisation  where it is computed
        """
        if self.numerical is None:
            return 0.0
        return sum(nuisance[name] * change for name, change in self.numerical.at(linearisation).items())

    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: Observed,
        linearisation: LinearisationPoint = BASE,
    ) -> Prediction:
        """The prediction for settings of effects and of the alignment. A gain pattern is fitted elsewhere: it has no
        mean of its own here.

        linearisation  where numerical errors are computed
        """
        shown = {name: values for name, values in physics.items() if not load(name).pattern}
        photons = float(np.exp(nuisance["log_photons"]))
        state = self.chain.state(shown, pose_of(nuisance), photons=photons, anode=self.anode)
        # The logarithm of noisy counts lies above that of their mean.
        above, variance = state.log_noise()
        lines = state.line_integrals()
        mean = nuisance["scale"] * lines + nuisance["offset"] + self.distortion(nuisance, linearisation) + above
        ratio = np.where(data.usable, variance / data.reference, 0)
        correlation = correlations(state, np.where(data.usable, 1 / data.reference, 0))
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(data.blocks.sum(ratio) / data.blocks.sum(data.usable))
        white = None if data.white is None else white_shape(state.measured_air[0])
        return Prediction(mean, log_variance, correlation, white, state, (lines, np.ones(lines.shape)))


def stacked(data: Observed, prediction: Prediction) -> list[np.ndarray]:
    """Residuals (observed less predicted) of the parts that are there: mean, its noise made white, variance,
    correlation, white."""
    parts = [data.whitened(np.where(data.usable, data.mean - prediction.mean, 0)).ravel()]
    if data.variance is not None:
        parts.append(np.nan_to_num(np.log(data.variance) - prediction.log_variance))
        parts.append(np.nan_to_num(data.correlation - prediction.correlation))
    if data.white is not None:
        parts.append(data.white - prediction.white)
    return parts


def weights(data: Observed, variance: np.ndarray, floor: np.ndarray) -> list[np.ndarray]:
    """Inverse variances of the same parts, 0 for what is not there.

    variance   [view, row, column] of one repeat's line integrals, whitened
    floor      [view, row, column] numerical error of the prediction, whitened, standard deviation
    """
    parts = [np.where(data.counted, 1 / (variance / data.n + floor**2), 0).ravel()]
    if data.variance is not None:
        for error in (data.variance_error, data.correlation_error):
            with np.errstate(divide="ignore", invalid="ignore"):
                parts.append(np.nan_to_num(1 / error**2, posinf=0.0))
        parts[1][~np.isfinite(data.variance)] = 0
    if data.white is not None:
        parts.append(np.full(data.white.size, 1 / WHITE_TOLERANCE**2))
    return parts
