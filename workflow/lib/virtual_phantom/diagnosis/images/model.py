"""Model of images: predictions of the simulation chain and a reconstruction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ...base.lru_cache import LRUCache
from ...base.streams import Stream, below, generator
from ...base.units import HU_AIR
from ...physics.chain import Chain
from ...physics.effect import Parameter, absolute_attenuation, acts_on_images, filter_factor, image_effects, load
from ...physics.image_state import ImageState
from ...physics.state import State
from ...simulation.reconstruct import apply_image_effects
from ..fitting.linearization import BASE, Linearization, LinearizationPoint, before_images
from ..fitting.model import Model
from ..fitting.nuisance import Nuisance, pose_of
from ..fitting.unknown import Unknown
from ..noise.condensed import Prediction
from ..projections.object_errors import ObjectErrors
from .observed import Condenser, ObservedImages

REALIZATIONS = 7  # of noise, reconstructed together; the mean is reconstructed separately
WATER_SD = 0.3  # SD of the scale if attenuation is absolute: scanners set water to 0 HU for every spectrum
CACHED_LINES = 2  # line integrals: of the mean and of noise
CACHED_IMAGES = 8  # settings; a Jacobian uses the images at its central point for every parameter
STARTS_PER_PERIOD = 2  # of a periodic parameter; chi-square had minima of about one period (benchmark image_effects)
EARLIER = 0  # branch of the random stream of the realizations


class ImagesModel(Model):
    """Predictions of images in HU, whitened.

    Parameters
    ----------
    chain, nuisances, **settings
        See Model.
    reconstruct : callable
        Line integrals, shape (lanes, views, rows, columns), to HU, shape (lanes, z, y, x).
    spacing_mm : tuple of 3 float
        Voxel size (z, y, x), mm.
    seed : Stream
        Random stream of the noise realizations. All predictions use the same realizations, so they change smoothly.
    filters : bool, optional
        Whether `reconstruct` takes `mtf`, as reconstruction.images.reconstruct_hu does; else images are filtered.
    """

    def __init__(
        self,
        chain: Chain,
        nuisances: tuple[Nuisance, ...],
        reconstruct: Callable[[np.ndarray], np.ndarray],
        spacing_mm: tuple[float, float, float],
        seed: Stream,
        *,
        filters: bool = False,
        object_errors: ObjectErrors | None = None,
        **settings,
    ):
        super().__init__(chain, nuisances, object_errors=object_errors or ObjectErrors(), **settings)
        self.reconstruct, self.spacing_mm, self._seed = reconstruct, spacing_mm, seed
        self.condenser: Condenser | None = None
        self.correction: np.ndarray | float = 0.0  # HU, of the error of finite pixels and voxels
        self.recorded_noise: np.ndarray | None = None  # HU, shape (repeats, z, y, x)
        self._filters = filters
        self._lines, self._images = LRUCache(CACHED_LINES), LRUCache(CACHED_IMAGES)

    def _unknown(self, name: str, parameter: Parameter) -> Unknown | None:
        """See Model; with starts in each period of a periodic length, and at the edge of the voxels that count."""
        found = super()._unknown(name, parameter)
        if found is None or name in self.declared:
            return found
        pixel = min(self.spacing_mm[1:])
        if parameter.periodic:
            # From half a pixel to two pixels. A period changes the number of pixels across the image by 1.
            step = 1 / (STARTS_PER_PERIOD * pixel * max(self.condenser.expected.shape[1:]))
            lengths = 1 / np.arange(max(0.5 / pixel, 1 / parameter.high), 2 / pixel, step)
        elif parameter.field_of_view:
            white = self.condenser.white
            radius = ImageState(white.sd, self.spacing_mm).radius_mm[white.used.any(axis=0)].max()
            lengths = [float(np.clip(radius + pixel, parameter.low, parameter.high))]
        else:
            return found
        return replace(found, starts=(*found.starts, *map(parameter.to_variable, lengths)))

    def nuisances_for(self, effects: tuple[str, ...]) -> tuple[Nuisance, ...]:
        """Return the nuisance parameters. With absolute attenuation, the scale has the wide prior of WATER_SD."""
        if not absolute_attenuation(self.with_declared_effects(effects)):
            return self.base_nuisances
        return tuple(
            replace(number, sd=max(number.sd, WATER_SD)) if number.name == "scale" else number
            for number in self.base_nuisances
        )

    def predict(self, physics, nuisance, data: ObservedImages, linearization: Linearization = BASE) -> Prediction:
        """Predict the data for effects and alignment; `mean` is whitened."""
        white = self.condenser.white
        mean = self.mean_image(physics, nuisance, linearization)
        design = (white(mean - HU_AIR), white(np.ones(mean.shape)))
        whitened = white(scaled(mean, nuisance)) + self.by_object_errors(nuisance)
        if data.variance is None:
            return Prediction(whitened, np.empty(0), None, design)
        noise = self.noise_images(physics, nuisance, linearization)
        statistics = self.condenser.noise(nuisance["scale"] * noise)
        with np.errstate(invalid="ignore", divide="ignore"):
            log_variance = np.log(statistics.variance)
        return Prediction(whitened, log_variance, statistics.correlation, design)

    def needs_relinearization(
        self, errors: LinearizationPoint, nuisance: Mapping[str, float], prediction, weights
    ) -> bool:
        """Return whether the object has moved by more than a voxel, so that its noise has changed."""
        here, there = pose_of(nuisance), pose_of(errors.nuisance)
        moved = (here.z_mm - there.z_mm, here.y_mm - there.y_mm, here.x_mm - there.x_mm)
        return bool((np.abs(moved) > self.spacing_mm).any())

    def repeats(self, physics, nuisance, linearization: Linearization, count: int) -> np.ndarray:
        """Return simulated images of a repeated scan, HU, shape (count, z, y, x).

        Noise is recorded (`recorded_noise`) or simulated, for at most REALIZATIONS images.
        """
        mean, noise = self.image(physics, nuisance, linearization), self.recorded_noise
        if noise is not None:
            return mean + noise[-count:]  # of the held-out slices
        return mean + nuisance["scale"] * self.noise_images(physics, nuisance, linearization)[:count]

    def image(self, physics, nuisance, linearization: Linearization = BASE) -> np.ndarray:
        """Return the image without noise, HU, shape (z, y, x); arguments as in `predict`."""
        mean = scaled(self.mean_image(physics, nuisance, linearization), nuisance)
        return mean + self.condenser.white.inverse(self.by_object_errors(nuisance))

    def by_object_errors(self, nuisance: Mapping[str, float]) -> np.ndarray:
        """Return the whitened change by errors of the stated object; image effects do not act on it."""
        if not self.object_errors.numbers:
            return np.zeros(self.condenser.white.sd.shape)
        return self.object_errors.lines(nuisance)

    def images(self, physics, nuisance, linearization: Linearization = BASE) -> tuple[np.ndarray, np.ndarray]:
        """Return `mean_image` and `noise_images`."""
        arguments = physics, nuisance, linearization
        return self.mean_image(*arguments), self.noise_images(*arguments)

    def mean_image(self, physics, nuisance, linearization: Linearization = BASE) -> np.ndarray:
        """Return the image without noise, before scale and offset, HU, shape (z, y, x); arguments as in `predict`."""
        before, settings, photons = self._before(physics, nuisance)
        here, rays = pose_of(nuisance), linearization.rays

        def lines() -> np.ndarray:
            state = self.linearized_at(rays).state(before, here, photons=photons, anode=self.anode)
            return (state.line_integrals() + state.log_noise()[0])[None]

        (image,), *filtered = self._reconstructed(("mean", settings, here, rays.key), lines, physics)
        pair = (image, filtered[0][0]) if filtered else ()
        return apply_image_effects(image + self.correction, self.spacing_mm, self._on_images(physics), pair)

    def noise_images(self, physics, nuisance, linearization: Linearization = BASE) -> np.ndarray:
        """Return noise before scale and offset, HU, for the object location in the linearization's `errors`.

        The shape is (realizations, z, y, x).
        """
        before, settings, photons = self._before(physics, nuisance)
        errors = linearization.errors

        def lines() -> np.ndarray:
            pose = pose_of(errors.nuisance)
            state = self.linearized_at(errors).state(before, pose, photons=photons, anode=self.anode)
            return noise_lines(state, REALIZATIONS, self._seed)

        images = [one - HU_AIR for one in self._reconstructed(("noise", settings, errors.key), lines, physics)]
        on_images, realizations = self._on_images(physics), images[0]
        if not on_images:
            return realizations
        zero = apply_image_effects(np.zeros_like(realizations[0]), self.spacing_mm, on_images)
        pairs = zip(*images, strict=True) if len(images) > 1 else [()] * len(realizations)
        return np.stack(
            [
                apply_image_effects(realization, self.spacing_mm, on_images, pair) - zero
                for realization, pair in zip(realizations, pairs, strict=True)
            ]
        )

    def _reconstructed(self, key: tuple, lines: Callable[[], np.ndarray], physics) -> list[np.ndarray]:
        """Return images from line integrals, and with the filter among the effects, if it is applied to projections.

        If the filter is the first effect, zeros replace the images without it, which would cancel.
        """

        def images(**filters) -> np.ndarray:
            return self.reconstruct(self._lines.get(key, lines), **filters)

        mtf = filter_factor(physics) if self._filters else None
        if mtf is None:
            return [self._images.get(key, images)]
        filtered = self._images.get((*key, mtf), lambda: images(mtf=mtf))
        first = min(self._on_images(physics), key=image_effects().index)
        return [np.zeros_like(filtered) if first == mtf.effect else self._images.get(key, images), filtered]

    def _before(self, physics, nuisance) -> tuple[dict, tuple, float]:
        """Return the effects that act before the reconstruction, their cache key, and the photons."""
        before, photons = before_images(physics), float(np.exp(nuisance["log_photons"]))
        return before, (LinearizationPoint(before).key, photons), photons

    @staticmethod
    def _on_images(physics) -> dict:
        return {key: values for key, values in physics.items() if acts_on_images(key) and not load(key).pattern}


def scaled(hu: np.ndarray, nuisance: Mapping[str, float]) -> np.ndarray:
    """Return images in HU with the scale and offset of an alignment."""
    return nuisance["scale"] * (hu - HU_AIR) + HU_AIR + nuisance["offset"]


def noise_lines(state: State, count: int, seed: Stream) -> np.ndarray:
    """Return first-order normal noise of line integrals: correlated quantum noise, and electronic noise.

    Parameters
    ----------
    seed : Stream
        The same seed gives the same underlying random numbers for every state.

    Returns
    -------
    ndarray of float32, shape (count, views, rows, columns)
    """
    # The signal before the scan is drawn for afterglow only, and has its own stream.
    random = generator(seed)
    earlier = generator(below(seed, EARLIER))
    signal = state.signal_per_line_integral
    lines = np.empty((count, *signal.shape), np.float32)
    for line in lines:
        variance = state.noise / state.photons
        before = state.sample_earlier_signal(np.zeros(signal.shape[1:]), variance[0], earlier)
        read = state.read_out(random.standard_normal(signal.shape) * np.sqrt(variance), before_scan=before)
        read += random.standard_normal(signal.shape) * (state.electronic / state.photons)
        line[...] = -read / signal
    return lines
