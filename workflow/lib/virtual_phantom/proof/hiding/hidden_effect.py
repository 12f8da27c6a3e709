"""An effect or fault that can be hidden: its strengths and the settings of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .objects import BENCH, DISC

READOUT_KEV = 60.0  # converts a dark signal from photons to readout units: the simulators read energy, in keV
MODULE_SHARE = 0.5  # of the variance of gains that is common to the columns of a detector module
STRENGTHS = ("weak", "medium", "strong")
MEAN = ("projections", "columns", "views", "rows", "path length", "edges")
NOISE = ("noise variance", "noise level")
IMAGE = ("image", "slices", "distance from the axis", "tissue", "edges")

# Objects that cannot show an effect. A homogeneous disc looks the same from all sides: at a wrong viewing angle, it is
# displaced by 0.02 mm per degree and mm of its distance from the axis.
ROUND, CONSTANT_ALONG_Z = (DISC,), (BENCH,)

# Origins of the equation that makes a hidden effect, {name: description}
EQUATIONS = {
    "simulator": "the simulator's own",
    "other": "another equation than the library's",
    "own": "the library's equation, written again",
}


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that can be hidden.

    Attributes
    ----------
    ranges : tuple of tuple of 2 float
        For each of STRENGTHS: bounds of the log-uniform distribution of the size.
    make : callable
        Maps (size, random generator) to the settings of the simulator and to the parameters of the library that have
        the same definition.
    where : tuple of str
        Domains of the diagnosis, at least one of which must show the effect.
    alike : str
        Group of effects that change the readings in nearly the same way; empty: none. A pair never has two effects of
        one group.
    unseen : tuple of str
        Kinds and descriptions of objects whose scans the effect does not change, apart from errors of the object.
    known : bool
        Whether the library has an effect of this name.
    of_images : bool
        Whether the effect belongs to the reconstruction, so that only images show it.
    right : str
        For effects that the library lacks: the best verdict, written down before any run.
    equals : tuple of tuple of str
        For effects that the library lacks: sets of its effects that are equivalent.
    """

    ranges: tuple[tuple[float, float], ...]
    make: Callable[[float, np.random.Generator], tuple[dict, dict]]
    where: tuple[str, ...]
    alike: str = ""
    unseen: tuple[str, ...] = ()
    known: bool = True
    of_images: bool = False
    right: str = ""
    equals: tuple[tuple[str, ...], ...] = ()

    def draw(self, strength: str, random: np.random.Generator) -> tuple[dict, dict]:
        """Draw a size for one of STRENGTHS and return the result of `make`."""
        low, high = self.ranges[STRENGTHS.index(strength)]
        return self.make(float(np.exp(random.uniform(np.log(low), np.log(high)))), random)


def sign(random: np.random.Generator) -> float:
    """Return 1 or -1 with equal chance."""
    return float(random.choice([-1.0, 1.0]))
