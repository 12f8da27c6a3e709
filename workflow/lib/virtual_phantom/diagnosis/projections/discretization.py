"""Errors of the model's own steps: what more rays per pixel and larger voxels change, of the model as it is fitted."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import numpy as np

from ...base.geometry import ScanGeometry
from ...base.recent import Kept
from ...physics.beam.spectra import TUNGSTEN, Anode
from ...physics.chain import Chain
from ...physics.scenes.inclusion import Inclusion
from ...physics.scenes.posed import PosedScene
from ...physics.state import Added
from ..fitting.linearization import NOMINAL, LinearisationPoint
from ..fitting.nuisance import pose_of

# Chi-square by which predictions may move until errors are computed again. On a scan of the proof (seed 1), a detector
# that is 0.19 pixels off moves them by 6 x 10^5. Errors left where they were are then taken for a focal spot, by 81 of
# log score; errors that follow are not.
MOST_STRAY = 500.0
KEPT = 4  # linearisation points: those that a choice goes back to
# Times as many rays per pixel and direction as the model has, what these change being its error: of voxels, and of what
# has path lengths in closed form. Edges of shapes are as sharp as can be: of a body with three inserts, 4 repeats of
# 1e5 photons and 2 rays, the error has a chi-square of 740,000 in 46,080 rays. Twice as many rays leave 150,000 of it,
# four times 30,000 (of voxels with sharp edges: 2,400 and 380).
FINER, FINER_OF_SHAPES = 2, 4
# Of what finer steps change: what is left of it once it is fitted, as errors of higher order are alike in no two rays.
LEFT = {"rays": 1.0, "voxels": 1 / 3}


def model_and_floor(scene, geometry: ScanGeometry, samples: int, **more) -> tuple[Chain, Chain]:
    """The chain that fits ask, its rays following those that were traced, and the one of more rays for Numerical.

    Parameters
    ----------
    scene : VoxelScene
        Or what has its methods; path lengths in closed form need not be followed.
    samples : int
        As Chain takes it, of the first.
    **more
        Keywords of Chain.
    """
    voxels = hasattr(scene, "slopes")
    return (
        Chain(PosedScene(scene, samples) if voxels else scene, geometry, samples=samples, **more),
        Chain(scene, geometry, samples=(FINER if voxels else FINER_OF_SHAPES) * samples, **more),
    )


def added_of(pieces: Mapping[str, Inclusion], nuisance: Mapping[str, float]) -> Added:
    """As State.added, of pieces by the number of the alignment that says how much each attenuates; 0 if none does."""
    return tuple((one, nuisance.get(name, 0.0)) for name, one in pieces.items())


class Numerical:
    """What finer steps change of the line integrals.

    Both differences follow the object's edges and lose what a blur takes off them, so that they are wanted of the
    effects that are fitted, where these let the rays run.

    Parameters
    ----------
    chain : Chain
        The simulator.
    finer : Chain or None
        The same with more rays per pixel, all of them traced.
    coarser : Chain or None
        The same of voxels twice as large.
    """

    def __init__(self, chain: Chain, finer: Chain | None, coarser: Chain | None, anode: Anode = TUNGSTEN):
        self._chain, self._finer, self._coarser, self._anode = chain, finer, coarser, anode
        self._kept, self._pieces = Kept(KEPT), {}
        self.names = tuple(name for name, one in (("rays", finer), ("voxels", coarser)) if one is not None)

    def with_pieces(self, pieces: Mapping[str, Inclusion]) -> Numerical:
        """Those of an object with pieces more, {number of the alignment: what attenuates by so much per mm}."""
        found = copy.copy(self)
        found._kept, found._pieces = Kept(KEPT), pieces
        return found

    def at(self, linearisation: LinearisationPoint = NOMINAL) -> dict[str, np.ndarray]:
        """By how much each step falls short of a finer one.

        Returns
        -------
        dict of str to ndarray, shape (views, rows, columns)
            By name.
        """
        return self._made(linearisation)[0]

    def left(self, linearisation: LinearisationPoint = NOMINAL) -> tuple[np.ndarray, ...]:
        """What is left of each error once it is fitted, in the order of `names`.

        Returns
        -------
        tuple of ndarray, shape (views, rows, columns)
            Standard deviations.
        """
        return tuple(LEFT[name] * error for name, error in self.at(linearisation).items())

    def strayed(self, linearisation: LinearisationPoint, lines: np.ndarray, weights: np.ndarray) -> bool:
        """Whether line integrals lie too far off those of a linearisation point.

        Parameters
        ----------
        lines, weights : ndarray, shape (views, rows, columns)
            Line integrals, and their inverse variances.
        """
        return float((weights * (lines - self._made(linearisation)[1]) ** 2).sum()) > MOST_STRAY

    def _made(self, linearisation: LinearisationPoint) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Errors, and the line integrals themselves."""
        return self._kept.get(linearisation.key, lambda: self._make(linearisation))

    def _make(self, linearisation: LinearisationPoint) -> tuple[dict[str, np.ndarray], np.ndarray]:
        def lines(chain: Chain) -> np.ndarray:
            added = added_of(self._pieces, linearisation.nuisance)
            pose = pose_of(linearisation.nuisance)
            return chain.state(linearisation.physics, pose, anode=self._anode, added=added).line_integrals()

        errors = {}
        if self._finer is None and self._coarser is None:
            return errors, lines(self._chain)
        # Copies, whose path lengths go when they have served. All are traced: the simulator of a fit may follow rays to
        # first order, which is no error of its steps.
        traced = self._chain if self._finer is None else self._finer.copy(samples=self._chain.samples)
        here = lines(traced)
        if self._finer is not None:
            errors["rays"] = lines(self._finer.copy()) - here
        if self._coarser is not None:
            errors["voxels"] = here - lines(self._coarser.copy())
        return errors, here
