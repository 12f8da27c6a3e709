"""Photons per pixel and view: XCIST's flux with heel effect, collimator and tube current modulation."""

import numpy as np
from gecatsim.pyfiles.Detection_Flux import Detection_Flux
from gecatsim.pyfiles.GetMu import GetMu

from .source import seen


def flux(cfg):
    """Multiply XCIST's flux by the heel effect and the tube current.

    Electrons stop at a depth d in tungsten with anode angle t. A ray at the cone angle a passes d / sin(t + a) of
    tungsten [1]_, here relative to the central ray. The current is modulated in the scan of the object only; a monitor
    corrects its mean.

    References
    ----------
    .. [1] J. Beutel et al., Handbook of Medical Imaging 1, chapter 1.
    """
    cfg = Detection_Flux(cfg)
    hooks = cfg.hooks
    if depth := hooks.heel_depth_mm:
        target = np.deg2rad(cfg.scanner.targetAngle)
        longer = 1 / np.sin(target + np.sign(depth) * cfg.det.alphas) - 1 / np.sin(target)
        mu = np.atleast_1d(GetMu("W", np.atleast_1d(cfg.spec.Evec))) / 10
        cfg.detFlux = np.single(cfg.detFlux * np.exp(-abs(depth) * longer * mu))
    if hooks.beside_mm:
        open_ = (cfg.src.weights[0][:, None] * seen(cfg, hooks.cells_divided)).sum(axis=0)
        open_ = open_.reshape(-1, hooks.cells_divided).mean(axis=1)
        hooks.open = np.repeat(open_, cfg.scanner.detectorRowCount)[:, None]  # cells: column by column
        cfg.detFlux = np.single(cfg.detFlux * hooks.open)
    if cfg.sim.isPhantomScan and any(hooks.modulation):
        hooks.current = tube_current(cfg, cfg.viewId)
        cfg.detFlux = np.single(cfg.detFlux * hooks.current)
    return cfg


def tube_current(cfg, view):
    """Return the relative current of one or more views, 1 + c cos 2b + s sin 2b at the gantry angle b."""
    cosine, sine = cfg.hooks.modulation
    turned = view / cfg.protocol.viewsPerRotation
    angle = np.deg2rad(cfg.protocol.startAngle) + 2 * np.pi * cfg.protocol.rotationDirection * turned
    return 1 + cosine * np.cos(2 * angle) + sine * np.sin(2 * angle)
