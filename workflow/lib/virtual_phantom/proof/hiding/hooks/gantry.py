"""Positions of source and detector in each view: XCIST's rotation with hidden displacements."""

import numpy as np
from gecatsim.pyfiles.Gantry_Helical import Gantry_Helical

from ..unsteady import breathed, jittered, swung, turned


def gantry(cfg):
    """Add displacements and rotations to XCIST's gantry; they also model a moving object.

    An object displaced by d equals a source and a detector displaced by -d. The same holds for rotations.
    """
    cfg = Gantry_Helical(cfg)
    hooks = cfg.hooks
    along, up = cfg.detNew.uvecs[0], cfg.detNew.vvecs[0]  # the directions of growing columns and rows
    shift = hooks.detector_columns_px * cfg.scanner.detectorColSize * along + hooks.detector_rows_mm * up
    interval = cfg.protocol.rotationTime / cfg.protocol.viewsPerRotation  # s
    time = (
        cfg.time + interval / 2 - interval * cfg.sim.viewCount / 2
    )  # middle of the view, relative to the middle of the scan
    displaced = hooks.axis_shift_mm * along + time * np.asarray(hooks.velocity_mm_per_s)
    drift = time * np.asarray(hooks.source_mm_per_s) @ [along, up, np.cross(up, along)]
    settings, turns, angle = vars(hooks), cfg.time / cfg.protocol.rotationTime, 0.0
    if any(hooks.angle_wave_deg):
        angle += np.dot(hooks.angle_wave_deg, [np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
    if "breathing_mm" in settings:
        displaced = displaced + breathed(turns, settings)
    if "swing_deg" in settings:
        angle -= swung(turns, settings)
    if "jitter_deg" in settings:
        angle += jittered(cfg.viewId, settings)
    cfg.detNew.modCoords = np.single(cfg.detNew.modCoords + shift - displaced)
    cfg.srcNew.samples = np.single(cfg.srcNew.samples - displaced + drift)
    cfg.srcNew.corners = np.single(cfg.srcNew.corners - displaced + drift)
    if angle:
        for part, names in ((cfg.detNew, ("modCoords", "uvecs", "vvecs")), (cfg.srcNew, ("samples", "corners"))):
            for name in names:
                setattr(part, name, np.single(turned(getattr(part, name), angle)))
    return cfg
