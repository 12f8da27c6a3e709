"""Photons per pixel and view: XCIST's flux with heel effect, collimator and tube current modulation."""

import numpy as np
from gecatsim.pyfiles.Detection_Flux import Detection_Flux
from gecatsim.pyfiles.GetMu import GetMu

from ..tube import heel, modulated
from .source import seen


def flux(cfg):
    """Multiply XCIST's flux by the heel effect, the collimator of off-focal radiation and the tube current.

    The current is modulated in the scan of the object only; a monitor corrects its mean.
    """
    cfg = Detection_Flux(cfg)
    hooks = cfg.hooks
    if depth := hooks.heel_depth_mm:
        mu = np.atleast_1d(GetMu("W", np.atleast_1d(cfg.spec.Evec))) / 10
        cfg.detFlux = np.single(cfg.detFlux * heel(np.ravel(cfg.det.alphas), depth, cfg.scanner.targetAngle, mu))
    if hooks.beside_mm:
        open_ = (cfg.src.weights[0][:, None] * seen(cfg, hooks.cells_divided[0])).sum(axis=0)
        open_ = open_.reshape(-1, hooks.cells_divided[0]).mean(axis=1)
        hooks.open = np.repeat(open_, cfg.scanner.detectorRowCount)[:, None]  # cells: column by column
        cfg.detFlux = np.single(cfg.detFlux * hooks.open)
    if cfg.sim.isPhantomScan and any(hooks.modulation):
        hooks.current = tube_current(cfg, cfg.viewId)
        cfg.detFlux = np.single(cfg.detFlux * hooks.current)
    return cfg


def tube_current(cfg, view):
    """Return the relative current of one or more views (tube.modulated)."""
    turned = view / cfg.protocol.viewsPerRotation
    angle = np.deg2rad(cfg.protocol.startAngle) + 2 * np.pi * cfg.protocol.rotationDirection * turned
    return modulated(angle, *cfg.hooks.modulation)
