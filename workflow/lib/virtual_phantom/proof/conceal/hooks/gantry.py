"""Places of source and detector in every view: XCIST's own, then what is displaced."""

import numpy as np
from gecatsim.pyfiles.Gantry_Helical import Gantry_Helical


def gantry(cfg):
    """XCIST's rotation, with a shifted detector, an axis beside the central ray, and an object that drifts.

    An object displaced by d is a source and a detector displaced by -d.

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
    cfg.detNew.modCoords = np.single(cfg.detNew.modCoords + shift - displaced)
    cfg.srcNew.samples = np.single(cfg.srcNew.samples - displaced)
    cfg.srcNew.corners = np.single(cfg.srcNew.corners - displaced)
    return cfg
