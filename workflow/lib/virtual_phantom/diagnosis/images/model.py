"""What the chain and a reconstruction predict of images."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ...base.recent import Kept
from ...base.streams import Stream, below, generator
from ...base.units import HU_AIR
from ...physics.beam.spectra import TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.effect import acts_on_images
from ...physics.state import State
from ...simulation.reconstruct import with_effects
from ..fitting.linearization import BASE, Linearisation, LinearisationPoint, before_images
from ..fitting.model import Model
from ..fitting.nuisance import Nuisance, pose_of
from ..fitting.priors import Statement
from ..noise.prediction import Prediction
from .observed import Condenser, ObservedImages

REALISATIONS = 7  # of noise; one more lane holds the mean
WATER_SD = 0.3  # of the scale beside a spectrum: scanners set HU by scans of water, whatever their energies
IMAGES_KEPT = 6  # of the last settings: a Jacobian goes back to its point for every number
EARLIER = 0  # branch of the realisations' stream


class ImagesModel(Model):
    """Predictions of images in HU, whitened.

    Parameters
    ----------
    chain, aligned, anode, tube_kvp, declared
        As Model takes them.
    reconstruct : callable
        Line integrals, shape (lanes, views, rows, columns), to HU, shape (lanes, z, y, x).
    spacing_mm : tuple of 3 float
        Of the voxels (z, y, x), mm.
    seed : Stream
        Of the realisations of noise, which all predictions share, so that they change smoothly.
    """

    def __init__(
        self,
        chain: Chain,
        aligned: tuple[Nuisance, ...],
        reconstruct: Callable[[np.ndarray], np.ndarray],
        spacing_mm: tuple[float, float, float],
        seed: Stream,
        anode: Anode = TUNGSTEN,
        tube_kvp: float | None = None,
        declared: Mapping[str, Mapping[str, Statement]] | None = None,
    ):
        super().__init__(chain, aligned, anode, tube_kvp, declared=declared)
        self.reconstruct, self.spacing_mm, self._seed = reconstruct, spacing_mm, seed
        self.condenser: Condenser | None = None
        self._means, self._noises = Kept(IMAGES_KEPT), Kept(IMAGES_KEPT)

    def alignment(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """The alignment beside these effects: with a spectrum the scale is free, as water has been set to 0 HU."""
        if "spectrum" not in self.whole(effects):
            return self.aligned
        return tuple(replace(one, sd=max(one.sd, WATER_SD)) if one.name == "scale" else one for one in self.aligned)

    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: ObservedImages,
        linearisation: Linearisation = BASE,
    ) -> Prediction:
        """The prediction for settings of effects and of the alignment: `mean` is whitened."""
        white = self.condenser.white
        mean, noise = self.images(physics, nuisance, linearisation)
        statistics = self.condenser.noise(nuisance["scale"] * noise)
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(statistics.variance)
        design = (white(mean - HU_AIR), white(np.ones(mean.shape)))
        return Prediction(white(scaled(mean, nuisance)), log_variance, statistics.correlation, design)

    def strayed(self, errors: LinearisationPoint, nuisance: Mapping[str, float], prediction, weights) -> bool:
        """As Model.strayed: whether the object has moved by more than a voxel, so that its noise is another's."""
        here, there = pose_of(nuisance), pose_of(errors.nuisance)
        moved = (here.z_mm - there.z_mm, here.y_mm - there.y_mm, here.x_mm - there.x_mm)
        return bool((np.abs(moved) > self.spacing_mm).any())

    def repeats(self, physics, nuisance, linearisation: Linearisation, count: int) -> np.ndarray:
        """Simulated images of a scan that is repeated.

        Parameters
        ----------
        physics, nuisance, linearisation
            As `predict` takes them.
        count : int
            At most REALISATIONS.

        Returns
        -------
        ndarray, shape (count, z, y, x)
            HU.
        """
        mean, noise = self.images(physics, nuisance, linearisation)
        return scaled(mean + noise[:count], nuisance)

    def images(self, physics, nuisance, linearisation: Linearisation = BASE) -> tuple[np.ndarray, np.ndarray]:
        """Mean and noise of images before scale and offset.

        Parameters
        ----------
        physics, nuisance, linearisation
            As `predict` takes them.

        Returns
        -------
        mean : ndarray, shape (z, y, x)
            HU.
        noise : ndarray, shape (realisations, z, y, x)
            HU; that of the object where the linearisation's `errors` have it.
        """
        on_images = {name: values for name, values in physics.items() if acts_on_images(name)}
        before, photons = before_images(physics), float(np.exp(nuisance["log_photons"]))
        settings = LinearisationPoint(before).key, photons
        here, rays, errors = pose_of(nuisance), linearisation.rays, linearisation.errors

        def mean() -> np.ndarray:
            state = self.near(rays).state(before, here, photons=photons, anode=self.anode)
            return self.reconstruct((state.line_integrals() + state.log_noise()[0])[None])[0]

        def noise() -> np.ndarray:
            state = self.near(errors).state(before, pose_of(errors.nuisance), photons=photons, anode=self.anode)
            return self.reconstruct(noise_lines(state, REALISATIONS, self._seed)) - HU_AIR

        image = self._means.get((settings, here, rays.key), mean)
        realisations = self._noises.get((settings, errors.key), noise)
        if not on_images:
            return image, realisations
        zero = with_effects(np.zeros_like(image), self.spacing_mm, on_images)
        changed = np.stack([with_effects(one, self.spacing_mm, on_images) - zero for one in realisations])
        return with_effects(image, self.spacing_mm, on_images), changed


def scaled(hu: np.ndarray, nuisance: Mapping[str, float]) -> np.ndarray:
    """Images in HU with the scale and offset of an alignment."""
    return nuisance["scale"] * (hu - HU_AIR) + HU_AIR + nuisance["offset"]


def noise_lines(state: State, count: int, seed: Stream) -> np.ndarray:
    """Noise of line integrals, to first order and normal: quantum noise as neighbours share it, and electronic noise.

    Parameters
    ----------
    count : int
        Of realisations.
    seed : Stream
        The same gives the same underlying draws in every state.

    Returns
    -------
    ndarray of float32, shape (count, views, rows, columns)
    """
    # What was before the scan is drawn with afterglow alone, and so from a stream of its own.
    random = generator(seed)
    earlier = generator(below(seed, EARLIER))
    signal = state.per_line
    lines = np.empty((count, *signal.shape), np.float32)
    for one in lines:
        variance = state.noise / state.photons
        before = state.drawn_before(np.zeros(signal.shape[1:]), variance[0], earlier)
        read = state.read(random.standard_normal(signal.shape) * np.sqrt(variance), first=before)
        read += random.standard_normal(signal.shape) * (state.electronic / state.photons)
        one[...] = -read / signal
    return lines
