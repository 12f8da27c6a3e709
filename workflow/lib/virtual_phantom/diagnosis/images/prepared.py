"""Preparation of images for fits: split, noise, and numerical errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import fft, ndimage, stats

from ...base.errors import InputError
from ...base.pose import Pose
from ...base.streams import Stream
from ...base.units import HU_AIR
from ...physics.beam.spectra import TUNGSTEN, Anode
from ...physics.chain import Chain
from ...statistics.image_quality import mean_frequency, noise_spectrum
from ..fitting.fit import Fit, Fitter
from ..fitting.linearization import before_images
from ..fitting.nuisance import NOMINAL_PHOTONS_SD, nuisances, pose_of
from ..fitting.priors import Statement, stated_physics
from ..projections.object_errors import ObjectErrors, StatedObject
from ..residuals.dataset import Prepared, ResidualMaps
from ..residuals.residual_tests import DomainTest, HalfResiduals
from .model import REALIZATIONS, ImagesModel, noise_lines
from .observed import Condenser
from .residual_maps import domain_tests
from .whitening import LEAST_POWER, LEAST_POWER_OF_SLICES, ImageWhitening, image_whitening, local_variance

OFFSET_SD_HU = 1.0  # of the zero of the HU scale
SIZE_SD = 0.003  # of an object in images: scanners state the size of their voxels this well
CORRECTION_LEFT = 0.5  # share of the correction for finite pixels and voxels that may be wrong
EDGE_VOXELS = 1.0  # SD of the average of this error
RECORDED_NOISE = 3  # repeats from which the noise is estimated from the data; with fewer, by simulation
FINE = 0.5  # of the highest in-plane frequency, above which noise dominates
TRIAL_PHOTONS = 1e5  # of simulated noise before it is scaled to the recording
NOISE_DIFFERS, NOISE_CLEAR = 0.25, 4.0  # change of mean frequency or noise that is stated, relative and in SD; choices
NULLS = 4  # batches of realizations for the scatter of noise statistics


DISPLAY = ResidualMaps(
    unit="hu",
    summed=0,
    down="row",
    across="column",
    profiles=(
        ("distance from the axis", "ring around the isocenter", 1),
        ("slices", "slice", 0),
        ("tissue", "voxels by HU (tenths)", 1),
    ),
    one_repeat="is that of the repeats held out, if there are two, else of simulated scans, scaled to what changes "
    "from voxel to voxel in the recording",
)


@dataclass(frozen=True)
class PreparedImages(Prepared):
    """Images prepared for fits.

    Attributes
    ----------
    noise_of_scan : float or None
        Ratio of noise standard deviations: another scan in place of an object, over the recording.
    """

    noise_of_scan: float | None = None
    display: ClassVar[ResidualMaps] = DISPLAY

    def domains(
        self, half: HalfResiduals, fit: Fit, fitted: HalfResiduals | None = None, more: Sequence[DomainTest] = ()
    ) -> list[DomainTest]:
        """See Prepared.domains."""
        return domain_tests(half, fitted, more)

    def caveats(self, fit: Fit) -> list[str]:
        """See Prepared.caveats; with the noise spectrum of slices, which is not fitted."""
        model, ratio = self.fitter.model, self.noise_of_scan
        if ratio is not None:  # the fitted noise includes both scans
            if ratio < 1 + NOISE_DIFFERS:
                return []
            return [f"The other scan has {ratio:.2g} times the noise of the recording: small differences are not seen."]
        if model.recorded_noise is None:
            return []
        simulated = model.noise_images(fit.physics, fit.nuisance, fit.linearization)
        try:
            spectra = [
                noise_spectrum(images, self.data.usable, model.spacing_mm) for images in (self.data.repeats, simulated)
            ]
        except InputError:  # the object is too small
            return []
        mine, other = map(mean_frequency, spectra)
        error = NOISE_CLEAR * np.hypot(mine.error, other.error)
        if abs(mine.value - other.value) < max(NOISE_DIFFERS * other.value, error):
            return []
        return [
            f"The noise spectrum differs: its mean frequency is {10 * mine.value:.3g} per cm in the recording and "
            f"{10 * other.value:.3g} per cm in the simulation with these effects. Iterative reconstruction and "
            "denoising change noise more than edges."
        ]

    def recorded(self, held_out: bool = False) -> np.ndarray:
        """See Prepared.recorded."""
        data = self.held_out if held_out else self.data
        return data.hu[data.usable]

    def difference(self, fit: Fit, held_out: bool) -> np.ndarray:
        """See Prepared.difference."""
        data = self.held_out if held_out else self.data
        left = data.hu - self.fitter.model.image(fit.physics, fit.nuisance, fit.linearization)
        if fit.pattern is not None:
            left -= data.white.inverse(np.where(data.usable, data.pattern_field(fit.pattern.values), 0))
        return left[data.usable]


def prepare(
    repeats: np.ndarray,
    further: np.ndarray | None,
    chain: Chain,
    floor_chain: Chain,
    reconstruct: Callable[[np.ndarray], np.ndarray],
    spacing_mm: tuple[float, float, float],
    valid: np.ndarray,
    seed: Stream,
    *,
    anode: Anode = TUNGSTEN,
    tube_kvp: float | None = None,
    nominal_photons: float | None = None,
    known: dict[str, float] | None = None,
    declared: Mapping[str, Mapping[str, Statement]] | None = None,
    location: Mapping[str, float] | None = None,
    slices_variance: float | None = None,
    reconstruct_finely: Callable[[np.ndarray], np.ndarray] | None = None,
    known_image: np.ndarray | None = None,
    known_error: np.ndarray | None = None,
    noise_of_scan: float | None = None,
    filters: bool = False,
    uncertain: StatedObject | None = None,
) -> PreparedImages:
    """Estimate noise, numerical errors and alignment of a recording.

    Parameters
    ----------
    repeats : ndarray, shape (repeats, z, y, x)
        HU.
    further : ndarray, shape (repeats, z, y, x), or None
        HU; held-out repeats.
    chain, floor_chain : Chain
        Chain for fits, and a chain with more rays. Their difference is the numerical error of predictions.
    reconstruct : callable
        Line integrals, shape (lanes, views, rows, columns), to HU on the same voxels, shape (lanes, z, y, x).
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    valid : ndarray of bool, shape (z, y, x)
        Voxels that were reconstructed from complete data.
    seed : Stream
        Random stream of simulated noise.
    anode, tube_kvp, nominal_photons, known, declared, location, uncertain
        See projections.prepared.prepare.
    slices_variance : float, optional
        If the repeats are slices of an object that is constant along z: factor of their sample variance that accounts
        for their correlation. Their noise is then only whitened, and not compared with a simulation.
    reconstruct_finely : callable, optional
        Like `reconstruct`, for line integrals of the floor chain, with finer voxels that are averaged. The difference
        of both images then corrects every prediction. None: `reconstruct`, and no correction.
    known_image : ndarray, shape (z, y, x), optional
        Image that the model gives with declared physics only, HU; replaces this correction.
    known_error : ndarray, shape (z, y, x), optional
        Standard deviation of errors of `known_image`, HU.
    noise_of_scan : float, optional
        See PreparedImages.
    filters : bool, optional
        Whether `reconstruct` takes `mtf`, as reconstruction.images.reconstruct_hu does; else images are filtered.

    Raises
    ------
    InputError
        If the repeats do not vary.
    """
    of_slices = slices_variance is not None
    given = {"offset": OFFSET_SD_HU} | ({"size": SIZE_SD} if of_slices else {}) | (known or {})

    def model(log_photons, sd, **more):
        aligned = nuisances(log_photons, sd, given, location=location)
        if of_slices:  # the same at every height
            aligned = tuple(number for number in aligned if number.name != "z_mm")
        label = {"anode": anode, "tube_kvp": tube_kvp, "declared": declared, "filters": filters}
        return ImagesModel(chain, aligned, reconstruct, spacing_mm, seed, **label, **more)

    blank = model(np.log(TRIAL_PHOTONS), np.inf)
    stated, place = stated_physics(declared or {}), dict(location or {})
    physics, pose = before_images(stated), pose_of(place)
    expected, simulated = blank.images(stated, {"log_photons": np.log(TRIAL_PHOTONS)} | place, blank.nominal)
    taken = repeats if further is None else np.concatenate([repeats, further])
    noise, ratio = _noise(taken, expected, simulated, valid)
    photons = TRIAL_PHOTONS / ratio
    lines = chain.state(physics, pose, anode=anode).line_integrals()
    if noise_of_scan is not None:
        # The mean of logarithms of noisy counts has a bias. Another scan contains the bias by its noise.
        bias = chain.state(physics, pose, photons=photons, anode=anode).log_noise()[0]
        lines = lines + 2 * noise_of_scan**2 / (1 + noise_of_scan**2) * bias
    coarse = reconstruct(lines[None])[0]
    finer = coarse
    if known_image is None:
        finely = reconstruct_finely or reconstruct
        finer = finely(floor_chain.state(physics, pose, anode=anode).line_integrals()[None])[0]
    if of_slices:
        noise = noise * np.sqrt(slices_variance)
    fitted, held, words, usable = _split(repeats, further, valid, of_slices)
    least = LEAST_POWER_OF_SLICES if of_slices else LEAST_POWER
    white = image_whitening(noise, valid, finer - coarse, len(fitted), least)
    # Noise that is not fitted does not determine the photons, so they need a prior.
    needs_prior = nominal_photons or len(fitted) == 1 or of_slices
    final = model(
        np.log(nominal_photons or photons),
        NOMINAL_PHOTONS_SD if needs_prior else np.inf,
        object_errors=_object_errors(uncertain, chain, pose, reconstruct, white),
    )
    if of_slices:
        final.recorded_noise, nulls = taken - taken.mean(axis=0), noise
        if known_image is not None:
            final.correction = known_image - coarse
        elif reconstruct_finely is not None:
            final.correction = finer - coarse
        expected = expected + final.correction
        final.condenser = Condenser(white, None, REALIZATIONS, expected)
    else:
        state = chain.state(physics, pose, photons=photons, anode=anode)
        batches = (reconstruct(noise_lines(state, REALIZATIONS, branch)) for branch in seed.spawn(NULLS))
        nulls = np.concatenate([batch - HU_AIR for batch in batches])
        final.condenser = Condenser(white, nulls, REALIZATIONS, expected)
    parts = zip((fitted, held, repeats), (*usable, valid), strict=True)
    data, held_out, every = (final.condenser.observe(part, use) for part, use in parts)
    errors = local_variance(white, nulls), _floor(white, final.correction, known_error)
    fitter, whole = (Fitter(final, *pair, *errors) for pair in ((data, held_out), (every, every)))
    return PreparedImages(fitter, whole, white.sd**2, words, len(repeats) == 1, photons, noise_of_scan=noise_of_scan)


def _noise(
    taken: np.ndarray, expected: np.ndarray, simulated: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return images of noise, and its variance relative to simulated noise.

    Parameters
    ----------
    taken, simulated : ndarray, shape (images, z, y, x)
        Repeats, and simulated noise.
    expected : ndarray, shape (z, y, x)

    Raises
    ------
    InputError
        If the repeats do not vary.
    """
    if len(taken) >= RECORDED_NOISE:
        noise = (taken - taken.mean(axis=0, dtype=np.float64)) * np.sqrt(len(taken) / (len(taken) - 1))
        # Over voxels, the ratio has an F distribution, whose median is not 1 for few repeats.
        ratios = (noise**2).mean(axis=0)[valid] / (simulated**2).mean(axis=0)[valid]
        ratio = float(np.median(ratios) / stats.f.median(len(taken) - 1, len(simulated)))
    else:
        ratio = _fine_power(taken[0] - expected, valid) / np.mean([_fine_power(noise, valid) for noise in simulated])
        noise = simulated * np.sqrt(ratio)
    if not ratio > 1e-9:
        raise InputError("the repeats are identical; remove the copies from repeats")
    return noise, ratio


def _object_errors(
    uncertain: StatedObject | None, chain: Chain, pose: Pose, reconstruct: Callable, white: ImageWhitening
) -> ObjectErrors:
    """Return the errors of the stated object, whose changes are whitened images."""
    if uncertain is None:
        return ObjectErrors()
    of_lines = uncertain.errors_without_edges(chain.geometry, chain.samples, pose)
    if not of_lines.numbers:
        return ObjectErrors()
    images = [white(reconstruct(change[None])[0] - HU_AIR).astype(np.float32) for change in of_lines.changes]
    return ObjectErrors(of_lines.numbers, np.stack(images))


def _floor(white: ImageWhitening, correction: np.ndarray | float, known_error: np.ndarray | None) -> np.ndarray:
    """Return the SD of the whitened numerical error of predictions, shape (z, y, x)."""
    # The correction is exact for one set of parameters; a part of it remains at edges that effects change.
    floor = CORRECTION_LEFT * np.abs(white(np.broadcast_to(correction, white.sd.shape)))
    if known_error is not None:
        floor = np.hypot(floor, white(np.broadcast_to(known_error, white.sd.shape)))
    return np.sqrt(ndimage.gaussian_filter(floor**2, (0, EDGE_VOXELS, EDGE_VOXELS)))


def _split(repeats, further, valid, of_slices):
    """Return fitted and held-out repeats, a description of the held-out part, and the voxels that count in each."""
    if further is not None:
        return repeats, further, "repeats kept for it", (valid, valid)
    if of_slices:  # neighboring slices have correlated noise
        middle = len(repeats) // 2
        return repeats[:middle], repeats[middle:], "the upper half of the slices", (valid, valid)
    if len(repeats) > 1:
        return repeats[0::2], repeats[1::2], "every second repeat", (valid, valid)
    upper = np.zeros(valid.shape, bool)
    upper[valid.shape[0] // 2 :] = True
    return repeats, repeats, "the upper half of the slices", (valid & ~upper, valid & upper)


def _fine_power(image: np.ndarray, valid: np.ndarray) -> float:
    """Return the mean power at high in-plane frequencies."""
    spectrum = fft.rfft2(np.where(valid, image, 0), axes=(1, 2))
    ky, kx = np.fft.fftfreq(image.shape[1]), np.fft.rfftfreq(image.shape[2])
    fine = np.hypot(ky[:, None], kx) > FINE / 2
    return float((np.abs(spectrum[:, fine]) ** 2).mean())
