"""Discretization errors of the fitted model, from more rays per pixel and from larger voxels."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.lru_cache import LRUCache
from ...physics.beam.spectra import TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.scenes.inclusion import Inclusion
from ...physics.scenes.posed import PosedScene
from ...physics.scenes.simulated import SimulatedScene
from ...physics.state import Inclusions
from ..fitting.linearization import NOMINAL, LinearizationPoint
from ..fitting.nuisance import pose_of

# Change of predictions, as chi-square, from which errors are recomputed. In a scan of the blind validation (seed 1), a
# detector offset of 0.19 pixels changes them by 6 x 10^5. Without recomputation, the errors look like a focal spot with
# a log score of 81.
MOST_STRAY = 500.0
CACHED_POINTS = 4  # linearization points
FINER = 2  # factor of the rays per pixel and direction that shows the error of the model
SIMULATED = "simulation"  # error of the user's own simulation, in units of the change by more rays per pixel
# Share of an error that remains after it is fitted, because errors of higher order differ from ray to ray.
LEFT = {"rays": 1.0, "voxels": 1 / 3, SIMULATED: 0.05}


def model_and_floor(scene, geometry: ScanGeometry, samples: int, **more) -> tuple[Chain, Chain]:
    """Return the chain for fits, and a chain with more rays for Numerical.

    In the first chain, path lengths through voxels are linearized for small displacements (PosedScene). Path lengths in
    closed form are not linearized.

    Parameters
    ----------
    samples : int
        Rays per pixel and direction of the first chain.
    """
    voxels = hasattr(scene, "slopes")
    return (
        Chain(PosedScene(scene, samples) if voxels else scene, geometry, samples=samples, **more),
        Chain(scene, geometry, samples=FINER * samples, **more),
    )


def inclusions_of(pieces: Mapping[str, Inclusion], nuisance: Mapping[str, float]) -> Inclusions:
    """Return State.added for pieces, each with its attenuation, a nuisance parameter; 0 if there is no value."""
    return tuple((piece, nuisance.get(name, 0.0)) for name, piece in pieces.items())


class Numerical:
    """Discretization errors of line integrals.

    Errors follow the edges of the object and are smoothed by blur. They are therefore computed with the fitted effects
    and geometry.

    Parameters
    ----------
    finer : Chain or None
        Chain with more rays per pixel, all of them traced.
    coarser : Chain or None
        Chain with voxels of twice the size.
    """

    def __init__(self, chain: Chain, finer: Chain | None, coarser: Chain | None, anode: Anode = TUNGSTEN):
        self._rays = SIMULATED if isinstance(chain.scene, SimulatedScene) else "rays"
        self._chain, self._finer, self._coarser, self._anode = chain, finer, coarser, anode
        self._cache, self._pieces = LRUCache(CACHED_POINTS), {}
        self.names = tuple(name for name, chain in ((self._rays, finer), ("voxels", coarser)) if chain is not None)

    def with_pieces(self, pieces: Mapping[str, Inclusion]) -> Numerical:
        """Return the errors for an object with pieces, {nuisance parameter with the attenuation: piece}."""
        found = copy.copy(self)
        found._cache, found._pieces = LRUCache(CACHED_POINTS), pieces
        return found

    def at(self, linearization: LinearizationPoint = NOMINAL) -> dict[str, np.ndarray]:
        """Return each error, shape (views, rows, columns), by name."""
        return self._made(linearization)[0] if self.names else {}

    def left(self, linearization: LinearizationPoint = NOMINAL) -> tuple[np.ndarray, ...]:
        """Return the SD that each error has after it is fitted, shape (views, rows, columns), in order of `names`."""
        return tuple(LEFT[name] * error for name, error in self.at(linearization).items())

    def needs_relinearization(self, linearization: LinearizationPoint, lines: np.ndarray, weights: np.ndarray) -> bool:
        """Return whether line integrals differ too much from their values at a linearization point.

        Parameters
        ----------
        lines, weights : ndarray, shape (views, rows, columns)
            Line integrals, and their inverse variances.
        """
        return float((weights * (lines - self._made(linearization)[1]) ** 2).sum()) > MOST_STRAY

    def _made(self, linearization: LinearizationPoint) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the errors and the line integrals themselves."""
        return self._cache.get(linearization.key, lambda: self._make(linearization))

    def _make(self, linearization: LinearizationPoint) -> tuple[dict[str, np.ndarray], np.ndarray]:
        def lines(chain: Chain) -> np.ndarray:
            added = inclusions_of(self._pieces, linearization.nuisance)
            pose = pose_of(linearization.nuisance)
            return chain.state(linearization.physics, pose, anode=self._anode, added=added).line_integrals()

        errors = {}
        # Copies release their path lengths after use. All rays are traced, since first-order displacements in the chain
        # for fits are no discretization error.
        traced = self._chain if self._finer is None else self._finer.copy(samples=self._chain.samples)
        here = lines(traced)
        if self._finer is not None:
            errors[self._rays] = lines(self._finer.copy()) - here
        if self._coarser is not None:
            errors["voxels"] = here - lines(self._coarser.copy())
        return errors, here
