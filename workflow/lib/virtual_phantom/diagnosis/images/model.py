"""What the chain and a reconstruction predict of images."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ...base.recent import Kept
from ...base.streams import Stream, below, generator
from ...base.units import HU_AIR
from ...physics.chain import Chain, State
from ...physics.effect import acts_on_images
from ...physics.image import with_effects
from ...physics.spectra import TUNGSTEN, Anode
from ..core.alignment import Nuisance, pose_of
from ..core.linearisation import BASE, LinearisationPoint
from ..core.model import Model
from ..core.prediction import Prediction
from .observed import Condenser, ObservedImages

REALISATIONS = 7  # of noise; one more lane holds the mean
WATER_SD = 0.3  # of the scale beside a spectrum: scanners set HU by scans of water, whatever their energies
IMAGES_KEPT = 6
EARLIER = 0  # branch of the realisations' stream


class ImagesModel(Model):
    """Predictions of images in HU, whitened.

    reconstruct   [lane, view, row, column] line integrals to [lane, z, y, x] in HU
    seed          of the realisations of noise, which all predictions share, so that they change smoothly
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
    ):
        super().__init__(chain, aligned, anode, tube_kvp)
        self.reconstruct, self.spacing_mm, self._seed = reconstruct, spacing_mm, seed
        self.condenser: Condenser | None = None
        self._means, self._noises = Kept(IMAGES_KEPT), Kept(IMAGES_KEPT)

    def alignment(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """The alignment beside these effects: with a spectrum the scale is free, as water has been set to 0 HU."""
        if "spectrum" not in effects:
            return self.aligned
        return tuple(replace(one, sd=max(one.sd, WATER_SD)) if one.name == "scale" else one for one in self.aligned)

    def predict(
        self,
        physics: Mapping[str, Mapping[str, float]],
        nuisance: Mapping[str, float],
        data: ObservedImages,
        linearisation: LinearisationPoint = BASE,
    ) -> Prediction:
        """The prediction for settings of effects and of the alignment: `mean` is whitened."""
        white = self.condenser.white
        mean, noise, _ = self.images(physics, nuisance)
        statistics = self.condenser.noise(nuisance["scale"] * noise)
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(statistics.variance)
        design = (white(mean - HU_AIR), white(np.ones(mean.shape)))
        return Prediction(white(scaled(mean, nuisance)), log_variance, statistics.correlation, design)

    def repeats(self, physics, nuisance, count: int) -> np.ndarray:
        """Simulated images [repeat, z, y, x] in HU, at most REALISATIONS."""
        mean, noise, _ = self.images(physics, nuisance)
        return scaled(mean + noise[:count], nuisance)

    def images(self, physics, nuisance) -> tuple[np.ndarray, np.ndarray, State]:
        """Mean [z, y, x] and noise [realisation, z, y, x] in HU before scale and offset, and the state of the chain."""
        on_images = {name: values for name, values in physics.items() if acts_on_images(name)}
        before = {name: dict(values) for name, values in physics.items() if name not in on_images}
        photons = float(np.exp(nuisance["log_photons"]))
        pose = pose_of(nuisance)
        state = self.chain.state(before, pose, photons=photons, anode=self.anode)
        key = (tuple((name, *sorted(values.items())) for name, values in sorted(before.items())), photons)

        # Where the object moves by less than a voxel, its noise stays, so that it does not count for the noise's key.
        lines = (state.line_integrals() + state.log_noise()[0])[None]
        if key not in self._noises:
            both = self.reconstruct(np.concatenate([lines, noise_lines(state, REALISATIONS, self._seed)]))
            self._means.get((key, pose), lambda: both[0])
            self._noises.get(key, lambda: both[1:] - HU_AIR)
        image = self._means.get((key, pose), lambda: self.reconstruct(lines)[0])
        realisations = self._noises.get(key)
        if not on_images:
            return image, realisations, state
        zero = with_effects(np.zeros_like(image), self.spacing_mm, on_images)
        changed = np.stack([with_effects(one, self.spacing_mm, on_images) - zero for one in realisations])
        return with_effects(image, self.spacing_mm, on_images), changed, state


def scaled(hu: np.ndarray, nuisance: Mapping[str, float]) -> np.ndarray:
    """Images in HU with the scale and offset of an alignment."""
    return nuisance["scale"] * (hu - HU_AIR) + HU_AIR + nuisance["offset"]


def noise_lines(state: State, count: int, seed: Stream) -> np.ndarray:
    """Noise of line integrals [realisation, view, row, column], to first order and normal: quantum noise as neighbours
    share it, and electronic noise. The same seed gives the same underlying draws in every state."""
    # What was before the scan is drawn with afterglow alone, and so from a stream of its own.
    random = generator(seed)
    earlier = generator(below(seed, EARLIER))
    signal = state.read(state.signal) if state.dark is None else state.measured
    lines = np.empty((count, *signal.shape), np.float32)
    for one in lines:
        variance = state.noise / state.photons
        before = state.drawn_before(np.zeros(signal.shape[1:]), variance[0], earlier)
        read = state.read(random.standard_normal(signal.shape) * np.sqrt(variance), first=before)
        read += random.standard_normal(signal.shape) * (state.electronic / state.photons)
        one[...] = -read / signal
    return lines
