"""Linearization points of predictions. Callers state them, so that predictions do not depend on earlier calls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...physics.effect import acts_on_images, load
from .nuisance import PIECE, POSES


def before_images(physics: Mapping[str, Mapping[str, float]]) -> dict[str, Mapping[str, float]]:
    """Return the settings of the effects in the chain, without effects on images and gain patterns."""
    return {name: values for name, values in physics.items() if not (acts_on_images(name) or load(name).pattern)}


@dataclass(frozen=True)
class LinearizationPoint:
    """Settings about which predictions are linearized.

    Attributes
    ----------
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}, for effects before images are made.
    nuisance : mapping of str to float
        Nuisance parameters of the object's pose and of local mismatches.
    """

    physics: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nuisance: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> LinearizationPoint:
        """Return the linearization point of all settings."""
        chain = {name: dict(values) for name, values in before_images(physics).items()}
        of_object = {name: value for name, value in nuisance.items() if name in POSES or name.startswith(PIECE)}
        return cls(chain, of_object)

    @property
    def key(self) -> tuple:
        """Hashable key, equal for equal points."""
        physics = tuple((name, *sorted(values.items())) for name, values in sorted(self.physics.items()))
        return physics, tuple(sorted(self.nuisance.items()))


NOMINAL = LinearizationPoint()


@dataclass(frozen=True)
class Linearization:
    """Linearization of predictions.

    Attributes
    ----------
    errors : LinearizationPoint
        Point where numerical errors and the noise of images are computed.
    rays : LinearizationPoint
        Point whose rays are traced; path lengths of other points are linearized about it.
    reach : float
        Factor of the linear range.
    """

    errors: LinearizationPoint = NOMINAL
    rays: LinearizationPoint = NOMINAL
    reach: float = 1.0


BASE = Linearization()
