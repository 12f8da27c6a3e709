"""Where predictions are linearised: said with every prediction, so that it depends on nothing that was asked before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...physics.effect import acts_on_images, load
from .nuisance import PIECE, POSES


def before_images(physics: Mapping[str, Mapping[str, float]]) -> dict[str, Mapping[str, float]]:
    """Settings of the effects that the chain knows: those on images, and patterns of pixels, come later."""
    return {name: values for name, values in physics.items() if not (acts_on_images(name) or load(name).pattern)}


@dataclass(frozen=True)
class LinearisationPoint:
    """Settings about which something is linearised.

    Attributes
    ----------
    physics : mapping of str to mapping of str to float
        {effect: {parameter: value}}, of those that act before images are made.
    nuisance : mapping of str to float
        The numbers of the alignment that move the object, and those of pieces of it.
    """

    physics: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nuisance: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> LinearisationPoint:
        """That of settings of effects and of the alignment."""
        chain = {name: dict(values) for name, values in before_images(physics).items()}
        of_object = {name: value for name, value in nuisance.items() if name in POSES or name.startswith(PIECE)}
        return cls(chain, of_object)

    @property
    def key(self) -> tuple:
        """Equal for linearisation points that are the same, and hashable."""
        physics = tuple((name, *sorted(values.items())) for name, values in sorted(self.physics.items()))
        return physics, tuple(sorted(self.nuisance.items()))


NOMINAL = LinearisationPoint()


@dataclass(frozen=True)
class Linearisation:
    """About what predictions are linearised.

    Attributes
    ----------
    errors : LinearisationPoint
        Where the errors of the model's own steps, and the noise of images, are computed.
    rays : LinearisationPoint
        Whose rays others follow to first order.
    reach : float
        Times as far as usual that they do.
    """

    errors: LinearisationPoint = NOMINAL
    rays: LinearisationPoint = NOMINAL
    reach: float = 1.0


BASE = Linearisation()
