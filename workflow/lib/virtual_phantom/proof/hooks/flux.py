"""Photons per pixel and view: XCIST's own, with a tube current that follows the gantry's angle."""

import numpy as np
from gecatsim.pyfiles.Detection_Flux import Detection_Flux


def flux(cfg):
    """XCIST's flux times 1 + c cos 2b + s sin 2b, in the scan of the object only: a monitor corrects its mean."""
    cfg = Detection_Flux(cfg)
    cosine, sine = cfg.hooks.modulation
    if cfg.sim.isPhantomScan and (cosine or sine):
        angle = np.deg2rad(cfg.protocol.startAngle) + 2 * np.pi * cfg.protocol.rotationDirection * (
            cfg.viewId / cfg.protocol.viewsPerRotation
        )
        cfg.hooks.current = 1 + cosine * np.cos(2 * angle) + sine * np.sin(2 * angle)
        cfg.detFlux = np.single(cfg.detFlux * cfg.hooks.current)
    return cfg
