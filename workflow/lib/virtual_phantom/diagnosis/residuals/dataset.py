"""A recording made ready for fits: what is fitted, what is held out, and how its differences are tested."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import sparray

from ..fitting.fit import Fit, Fitter
from ..noise.condensed import Observed
from .change import PieceOfObject
from .display import ResidualMaps
from .residual_tests import Half, Location


@dataclass(frozen=True)
class Prepared(ABC):
    """What all fits of a recording share, and what a kind of recording says of itself.

    Attributes
    ----------
    look : ResidualMaps
        Of the kind of recording.
    data, held_out : Observed
        What is fitted, and what is held out.
    variance : ndarray
        Of one repeat, along the data's three axes.
    held : str
        What is held out, in words.
    single : bool
        True if the noise had to be taken from a single repeat.
    photons : float
        Per pixel in air, as estimated from the variances.
    step : int
        One view of so many was fitted or held out.
    lacking : str or None
        What of the scan's times is not stated, in words.
    voxels : str or None
        What whole voxels that the object is drawn in leave of its edges, and what would tell, in words; None: nothing.
    """

    look: ClassVar[ResidualMaps]

    fitter: Fitter
    data: Observed
    held_out: Observed
    variance: np.ndarray
    held: str
    single: bool
    photons: float
    step: int = 1
    lacking: str | None = None
    voxels: str | None = None

    @property
    def usable(self) -> np.ndarray:
        """Data that count, fitted and held out, along three axes."""
        return self.data.usable & self.held_out.usable

    def half(self, fit: Fit, held_out: bool) -> Half:
        """What a fit leaves of the data held out, or of those fitted."""
        fitter = self.fitter
        if held_out:
            return Half(fitter.residuals(fit), fitter.held_weights, self.held_out)
        return Half(fitter.residuals(fit, held_out=False), fitter.weights, self.data)

    def halves(self, fit: Fit) -> tuple[Half, Half]:
        """What a fit leaves of the data fitted, and of those held out."""
        return self.half(fit, held_out=False), self.half(fit, held_out=True)

    @abstractmethod
    def domains(
        self, half: Half, fit: Fit, fitted: Half | None = None, more: Sequence[Location] = ()
    ) -> list[Location]:
        """Where a half and a fit differ beyond noise, by domain.

        Parameters
        ----------
        fitted : Half, optional
            The data that the model was fitted to, where `half` are others: then errors of the fit count too.
        more : sequence of Location, optional
            Domains that residuals do not show.

        Returns
        -------
        list of Location
            The worst first.
        """

    def kinds(self, fit: Fit) -> Iterable[tuple[str, np.ndarray | sparray]]:
        """Kinds of change about what a fit predicts: each in words, and its directions; none by default.

        Returns
        -------
        iterable of tuple of str and ndarray or sparse array, shape (mean data, directions)
        """
        return ()

    def piece(self, fit: Fit) -> PieceOfObject | None:
        """The piece of the object whose change would explain most of what a fit leaves of the data fitted.

        Returns
        -------
        PieceOfObject or None
            None where none can be told, and by default.
        """
        return None

    def with_piece(self, piece: PieceOfObject, fit: Fit) -> Prepared:
        """The same of an object with that piece, which moves with it and of which the attenuation is fitted.

        Its place and width are found anew, beside the alignment that fits an object with it.

        Parameters
        ----------
        piece : PieceOfObject
            As `piece` gives it.
        fit : Fit
            Beside whose effects that is.
        """
        raise NotImplementedError

    def pieces(self, fit: Fit) -> Sequence[PieceOfObject]:
        """The pieces that this object has beside what was stated, with what a fit says of them; none by default."""
        return ()

    @abstractmethod
    def recorded(self) -> np.ndarray:
        """The data that were fitted, in the unit of `look`, where they count: one-dimensional."""

    @abstractmethod
    def difference(self, fit: Fit, held_out: bool) -> np.ndarray:
        """Recorded less modelled in the unit of `look`, where data count: one-dimensional."""

    def share_at_edges(self, fit: Fit) -> float | None:
        """Of what a fit leaves of the data held out, the share that lies where these change most.

        Returns
        -------
        float or None
            Of chi-square beyond noise; None where nothing is beyond it, and by default.
        """
        return None

    def with_noise_of(self, fit: Fit) -> Prepared:
        """The same with noise as a fit says that it is correlated, where recordings do not say it themselves."""
        return self

    def caveats(self) -> list[str]:
        """Sentences for the report about what was recorded, none if all is well."""
        return []
