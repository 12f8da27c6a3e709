"""What can be concealed: an effect or a kind of fault, how strong, and how the simulator is asked for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

STRENGTHS = ("weak", "medium", "strong")
MEAN = ("projections", "columns", "views", "rows", "path length", "edges")
NOISE = ("noise variance", "noise level")
IMAGE = ("image", "slices", "distance from the axis", "tissue", "edges")


@dataclass(frozen=True)
class Concealable:
    """An effect that can be concealed.

    Attributes
    ----------
    known : bool
        The library has an effect of this name.
    ranges : mapping of str to tuple of 2 float
        {strength: (low, high)} from which its size is drawn, log-uniform.
    make : callable
        (size, random generator) to the simulator's settings, and those of the library's parameters that are defined
        alike.
    where : tuple of str
        Domains of the diagnosis, at least one of which must show it.
    alike : str
        Effects of one group change the readings nearly alike, and no pair is drawn from it.
    of_images : bool
        It is the reconstruction's, and images alone show it.
    right : str
        Of what the library lacks: the verdict that is right, written down before any run.
    equals : tuple of tuple of str
        Of what the library lacks: sets of its effects, each of which stands for it by right.
    """

    known: bool
    ranges: Mapping[str, tuple[float, float]]
    make: Callable[[float, np.random.Generator], tuple[dict, dict]]
    where: tuple[str, ...]
    alike: str = ""
    of_images: bool = False
    right: str = ""
    equals: tuple[tuple[str, ...], ...] = ()

    def draw(self, strength: str, random: np.random.Generator) -> tuple[dict, dict]:
        """A size of this strength, as `make` gives it.

        Parameters
        ----------
        strength : str
            Of STRENGTHS.
        """
        low, high = self.ranges[strength]
        return self.make(float(np.exp(random.uniform(np.log(low), np.log(high)))), random)


def ranges(*bounds: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Bounds by STRENGTHS."""
    return dict(zip(STRENGTHS, bounds, strict=True))


def sign(random: np.random.Generator) -> float:
    """1 or -1."""
    return float(random.choice([-1.0, 1.0]))
