"""Places of source and detector in every view: XCIST's own, then what is displaced."""

import numpy as np
from gecatsim.pyfiles.Gantry_Helical import Gantry_Helical

from ..unsteady import breathed, jittered, swung, turned


def gantry(cfg):
    """XCIST's rotation, with a shifted detector, an axis beside the central ray, and an unsteady object.

    An object displaced by d is a source and a detector displaced by -d, and one turned by an angle these turned back.

    Parameters
    ----------
    cfg : gecatsim.CFG

    Returns
    -------
    gecatsim.CFG
    """
    cfg = Gantry_Helical(cfg)
    hooks = cfg.hooks
    along = cfg.detNew.uvecs[0]  # the direction of growing columns
    shift = hooks.detector_columns_px * cfg.scanner.detectorColSize * along
    interval = cfg.protocol.rotationTime / cfg.protocol.viewsPerRotation  # s
    time = cfg.time + interval / 2 - interval * cfg.sim.viewCount / 2  # of the view's middle, from the scan's
    displaced = hooks.axis_shift_mm * along + time * np.asarray(hooks.velocity_mm_per_s)
    settings, turns, angle = vars(hooks), cfg.time / cfg.protocol.rotationTime, 0.0
    if "breathing_mm" in settings:
        displaced = displaced + breathed(turns, settings)
    if "swing_deg" in settings:
        angle -= swung(turns, settings)
    if "jitter_deg" in settings:
        angle += jittered(cfg.viewId, settings)
    cfg.detNew.modCoords = np.single(cfg.detNew.modCoords + shift - displaced)
    cfg.srcNew.samples = np.single(cfg.srcNew.samples - displaced)
    cfg.srcNew.corners = np.single(cfg.srcNew.corners - displaced)
    if angle:
        for part, names in ((cfg.detNew, ("modCoords", "uvecs", "vvecs")), (cfg.srcNew, ("samples", "corners"))):
            for name in names:
                setattr(part, name, np.single(turned(getattr(part, name), angle)))
    return cfg
