"""Recording prepared for fits: fitted and held-out data, and the tests of their residuals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import sparray

from ..fitting.fit import Fit, Fitter
from ..noise.condensed import Observed
from .residual_tests import DomainTest, HalfResiduals


@dataclass(frozen=True)
class ResidualMaps:
    """Display of residuals of a kind of recording in reports and figures.

    Attributes
    ----------
    unit : str
        Unit of differences, as in names of metrics.
    summed : int
        Axis of the data over which maps are summed.
    down, across : str
        Labels of the axes of maps.
    profiles : tuple of tuple of (str, str, int)
        Domain, label of the axis, and number of the first position.
    one_repeat : str
        Origin of the noise estimate for a single repeat, as the rest of a sentence.
    ranked : bool
        Whether further recordings of the kind are ranked (diagnosis.planning).
    """

    unit: str
    summed: int
    down: str
    across: str
    profiles: tuple[tuple[str, str, int], ...]
    one_repeat: str
    ranked: bool = False


@dataclass(frozen=True)
class LocalMismatch:
    """Local object mismatch: a ball or rod in which the object differs from what was stated.

    Attributes
    ----------
    directions : ndarray, shape (mean data, 1)
        Path lengths in the piece, mm.
    piece : projections.local_mismatch.Piece
        Its shape.
    """

    words: str
    content: Mapping
    directions: np.ndarray
    piece: Any


@dataclass(frozen=True)
class Change:
    """Test of one kind of change of the data that no parameter of a fit describes.

    Attributes
    ----------
    words : str
        Description, a verb phrase.
    z : float
        Standardized held-out residual along the direction that the fitted data determine.
    p : float
        p-value of z.
    gain : float
        Increase of the held-out log score by the change, with its size shrunk toward 0 because of noise (W. James and
        C. Stein, Proc. 4th Berkeley Symp. 1, 361, 1961).
    mismatch : LocalMismatch or None
        None for changes of other kinds.
    """

    words: str
    z: float
    p: float
    gain: float
    mismatch: LocalMismatch | None = None


@dataclass(frozen=True)
class Prepared(ABC):
    """Recording prepared for fits, of any kind.

    Attributes
    ----------
    fitter, whole : Fitter
        Fits of one part of the data, scored by the rest, and fits of all repeats. Repeats that the recording lists as
        `held_out` are never fitted.
    variance : ndarray
        Variance of one repeat, along the data's three axes.
    single : bool
        Whether the noise was estimated from a single repeat.
    photons : float
        Photons per pixel in air, estimated from the variances.
    step : int
        Step between the views that are fitted or held out.
    time_remark : str or None
        Remark on times that the description of the scan lacks.
    voxels : str or None
        Remark on residuals at edges that the voxels of the object cause; None if voxels cause none.
    """

    display: ClassVar[ResidualMaps]

    fitter: Fitter
    whole: Fitter
    variance: np.ndarray
    held_out_text: str
    single: bool
    photons: float
    step: int = 1
    time_remark: str | None = None
    voxels: str | None = None

    @property
    def data(self) -> Observed:
        """Fitted data."""
        return self.fitter.data

    @property
    def held_out(self) -> Observed:
        """Held-out data."""
        return self.fitter.held_out

    @property
    def usable(self) -> np.ndarray:
        """Mask of the data that are used in both halves, along three axes."""
        return self.data.usable & self.held_out.usable

    def half(self, fit: Fit, held_out: bool) -> HalfResiduals:
        """Return a fit's residuals of the held-out or of the fitted data."""
        fitter = self.fitter
        data, weights = (self.held_out, fitter.held_weights) if held_out else (self.data, fitter.weights)
        return HalfResiduals(fitter.residuals(fit, held_out), weights, data)

    def halves(self, fit: Fit) -> tuple[HalfResiduals, HalfResiduals]:
        """Return a fit's residuals of the fitted and of the held-out data."""
        return self.half(fit, held_out=False), self.half(fit, held_out=True)

    @abstractmethod
    def domains(
        self, half: HalfResiduals, fit: Fit, fitted: HalfResiduals | None = None, more: Sequence[DomainTest] = ()
    ) -> list[DomainTest]:
        """Test a half for differences from a fit beyond noise, by domain.

        Parameters
        ----------
        fitted : HalfResiduals, optional
            Fitted data, if `half` is held-out data. The tests then include errors of the fit.
        more : sequence of DomainTest, optional
            Tests of further domains, which are not based on residuals.

        Returns
        -------
        list of DomainTest
            The worst first.
        """

    def kinds(self, fit: Fit) -> Iterable[tuple[str, np.ndarray | sparray]]:
        """Yield kinds of change of a fit's predictions: description, and directions, (mean data, directions)."""
        return ()

    def local_mismatch(self, fit: Fit) -> LocalMismatch | None:
        """Return the local object mismatch that explains most of a fit's residuals, if one can be found."""
        return None

    def with_mismatch(self, mismatch: LocalMismatch, fit: Fit) -> Prepared:
        """Return the recording with a local object mismatch that moves with the object and whose attenuation is fitted.

        Position and width are fitted again, together with the effects of the fit and the nuisance parameters.
        """
        raise NotImplementedError

    def mismatches(self, fit: Fit) -> Sequence[LocalMismatch]:
        """Return the local object mismatches that the model includes, with the values of a fit; none by default."""
        return ()

    @abstractmethod
    def recorded(self, held_out: bool = False) -> np.ndarray:
        """Return the fitted or the held-out data in the unit of `display`, one-dimensional."""

    @abstractmethod
    def difference(self, fit: Fit, held_out: bool) -> np.ndarray:
        """Return recorded minus modeled data in the unit of `display`, one-dimensional."""

    def share_at_edges(self, fit: Fit) -> float:
        """Return the share of chi-square beyond noise at the steepest data; 0 if nothing exceeds noise."""
        return 0.0

    def with_noise_of(self, fit: Fit) -> Prepared:
        """Return the recording with the noise correlations of a fit, if the recording does not determine them."""
        return self

    def linearized_at(self, fit: Fit, most_error: float) -> Prepared:
        """Return the recording with errors of the object linearized at a fit; itself if it needs no change.

        Parameters
        ----------
        most_error : float
            Chi-square of the change of the fit's prediction, up to which the recording stays as it is.
        """
        return self

    def caveats(self, fit: Fit) -> list[str]:
        """Return sentences for the report on limits of the recording and of a fit."""
        return []
