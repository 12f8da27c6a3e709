"""Positions of source and detector in each view: XCIST's rotation with hidden displacements."""

import numpy as np
from gecatsim.pyfiles.Gantry_Helical import Gantry_Helical

from ..unsteady import displacement, turned


def gantry(cfg):
    """Add displacements and rotations to XCIST's gantry; they also model a moving object.

    An object displaced by d equals a source and a detector displaced by -d. The same holds for rotations.
    """
    cfg = Gantry_Helical(cfg)
    along, up = np.ravel(cfg.srcNew.lateral), cfg.detNew.vvecs[0]  # the directions of growing columns and rows
    interval = cfg.protocol.rotationTime / cfg.protocol.viewsPerRotation  # s
    turns, views = cfg.time / cfg.protocol.rotationTime, cfg.sim.viewCount
    moved = displacement(vars(cfg.hooks), cfg.viewId, views, turns, interval * views, along, up)
    cfg.detNew.modCoords = np.single(cfg.detNew.modCoords - moved.object_mm)
    cfg.srcNew.samples = np.single(cfg.srcNew.samples - moved.object_mm + moved.source_mm)
    cfg.srcNew.corners = np.single(cfg.srcNew.corners - moved.object_mm + moved.source_mm)
    if moved.turn_deg:
        for part, names in ((cfg.detNew, ("modCoords", "uvecs", "vvecs")), (cfg.srcNew, ("samples", "corners"))):
            for name in names:
                setattr(part, name, np.single(turned(getattr(part, name), moved.turn_deg)))
    return cfg
