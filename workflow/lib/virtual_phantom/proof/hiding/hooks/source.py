"""The source's samples: XCIST's focal spot, and radiation from around it."""

import numpy as np
from gecatsim.pyfiles.SetFocalspot import SetFocalspot

OFF_FOCAL_SAMPLES = 6


def source(cfg):
    """XCIST's focal spot, and a share of off-focal radiation: electrons scattered back strike the anode elsewhere.

    They are taken to lie along the columns, with a Gaussian profile of the given full width at half maximum.
    """
    cfg = SetFocalspot(cfg)
    cfg.hooks.beside_mm = ()
    share, width = cfg.hooks.off_focal_share, cfg.hooks.off_focal_width_mm
    if share:
        places = (np.arange(OFF_FOCAL_SAMPLES) - (OFF_FOCAL_SAMPLES - 1) / 2) * 2 * width / OFF_FOCAL_SAMPLES
        weights = np.exp(-4 * np.log(2) * (places / width) ** 2)
        more = np.repeat(cfg.src.samples.mean(axis=0, keepdims=True), OFF_FOCAL_SAMPLES, axis=0)
        more[:, 0] += places
        cfg.src.samples = np.single(np.vstack([cfg.src.samples, more]))
        cfg.src.weights = np.single(np.hstack([cfg.src.weights * (1 - share), share * (weights / weights.sum())[None]]))
        cfg.src.nSamples = len(cfg.src.samples)
        cfg.hooks.beside_mm = tuple(places)
    return cfg


def seen(cfg, divided):
    """What of every point of the source each column sees past the pre-patient collimator.

    The beam of the focal spot just fits through the collimator.

    Parameters
    ----------
    divided : int
        Finer columns per column of the detector.

    Returns
    -------
    ndarray of bool, shape (points, columns * divided)
        Of the focal spot all.
    """
    hooks, scanner = cfg.hooks, cfg.scanner
    columns = scanner.detectorColCount * divided
    place = (np.arange(columns) - (columns - 1) / 2) * scanner.detectorColSize / divided
    spot = cfg.src.nSamples - len(hooks.beside_mm)
    found = np.ones((cfg.src.nSamples, columns), bool)
    if collimator := hooks.off_focal_collimator_mm:
        beside = np.asarray(hooks.beside_mm)[:, None] * (1 - collimator / scanner.sdd)
        at_collimator = beside + place * collimator / scanner.sdd
        half = scanner.detectorColCount * scanner.detectorColSize / 2 * collimator / scanner.sdd
        found[spot:] = np.abs(at_collimator) <= half
    return found
