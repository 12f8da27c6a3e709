"""Detector callback for XCIST that reads out all repeats of a view from one projection."""

import numpy as np
from gecatsim.pyfiles.Detection_EI import Detection_EI

from ..faults import refracted


def detection(cfg, view, subview):
    """Add up the subviews of a view, then run XCIST's detection once per repeat, each with its own noise and lag.

    Readings are appended to `cfg.hooks.views`, shape (repeats, rows, columns).
    """
    hooks = cfg.hooks
    hooks.photons = cfg.thisSubView.copy() if subview == 0 else hooks.photons + cfg.thisSubView
    subviews = cfg.sim.subViewCount
    if subview < subviews - 1:
        return cfg
    if (amount := vars(hooks).get("refraction", 0.0)) and not cfg.sim.isAirScan:
        shape = cfg.scanner.detectorColCount, cfg.scanner.detectorRowCount, -1
        hooks.photons = refracted(hooks.photons.reshape(shape), amount).reshape(hooks.photons.shape)
    readings = []
    repeats = 1 if cfg.sim.isAirScan else hooks.repeats
    cfg.sim.subViewCount = 1  # one detection for their sum: a sum of Poisson counts is a Poisson count
    for repeat in range(repeats):
        cfg.thisSubView = hooks.photons.copy()
        if view > cfg.sim.startViewId and cfg.physics.lagCallback:
            cfg.memview1, cfg.memview2 = hooks.lag[repeat]
        cfg = Detection_EI(cfg, view, 0)
        if cfg.physics.lagCallback:
            hooks.lag[repeat] = cfg.memview1, cfg.memview2
        reading = cfg.thisView.reshape(cfg.scanner.detectorColCount, cfg.scanner.detectorRowCount).T
        readings.append(reading / hooks.current)
    cfg.sim.subViewCount = subviews
    hooks.views.append(np.stack(readings).astype(np.float32))
    if cfg.sim.isAirScan:
        absorbed = hooks.photons * cfg.sim.Wvec
        energies = np.atleast_1d(cfg.sim.Evec)
        hooks.quanta = (absorbed @ energies) ** 2 / (absorbed @ energies**2)
    return cfg
