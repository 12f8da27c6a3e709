"""What is modelled where predictions are linearised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...physics.effect import load
from .alignment import POSES


@dataclass(frozen=True)
class LinearisationPoint:
    """What is modelled when errors are computed.

    physics   {effect: {parameter: value}}
    nuisance  the numbers of the alignment that move the object
    """

    physics: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    nuisance: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, physics: Mapping[str, Mapping[str, float]], nuisance: Mapping[str, float]) -> LinearisationPoint:
        """That of settings of effects and of the alignment."""
        smooth = {name: dict(values) for name, values in physics.items() if not load(name).pattern}
        return cls(smooth, {name: nuisance[name] for name in POSES if name in nuisance})

    @property
    def key(self) -> tuple:
        """Equal for linearisation points that are the same, and hashable."""
        physics = tuple((name, *sorted(values.items())) for name, values in sorted(self.physics.items()))
        return physics, tuple(sorted(self.nuisance.items()))


BASE = LinearisationPoint()
