"""Sample points of the source: XCIST's focal spot and off-focal radiation."""

import numpy as np
from gecatsim.pyfiles.SetFocalspot import SetFocalspot

OFF_FOCAL_SAMPLES = 6


def source(cfg):
    """Add off-focal radiation to XCIST's focal spot: scattered electrons hit the anode outside of the focal spot.

    The off-focal points lie along the columns, with a Gaussian profile of the given full width at half maximum.
    """
    cfg = SetFocalspot(cfg)
    cfg.hooks.beside_mm = ()
    share, width = cfg.hooks.off_focal_share, cfg.hooks.off_focal_width_mm
    if share:
        positions = (np.arange(OFF_FOCAL_SAMPLES) - (OFF_FOCAL_SAMPLES - 1) / 2) * 2 * width / OFF_FOCAL_SAMPLES
        weights = np.exp(-4 * np.log(2) * (positions / width) ** 2)
        points = np.repeat(cfg.src.samples.mean(axis=0, keepdims=True), OFF_FOCAL_SAMPLES, axis=0)
        points[:, 0] += positions
        cfg.src.samples = np.single(np.vstack([cfg.src.samples, points]))
        cfg.src.weights = np.single(np.hstack([cfg.src.weights * (1 - share), share * (weights / weights.sum())[None]]))
        cfg.src.nSamples = len(cfg.src.samples)
        cfg.hooks.beside_mm = tuple(positions)
    return cfg


def seen(cfg, divided):
    """Return which points of the source each column sees through the pre-patient collimator.

    The beam of the focal spot just fits through the collimator.

    Parameters
    ----------
    divided : int
        Subdivision of the detector's columns.

    Returns
    -------
    ndarray of bool, shape (points, columns * divided)
        True for all points of the focal spot.
    """
    hooks, scanner = cfg.hooks, cfg.scanner
    columns = scanner.detectorColCount * divided
    position = (np.arange(columns) - (columns - 1) / 2) * scanner.detectorColSize / divided
    spot = cfg.src.nSamples - len(hooks.beside_mm)
    found = np.ones((cfg.src.nSamples, columns), bool)
    if collimator := hooks.off_focal_collimator_mm:
        off_focal = np.asarray(hooks.beside_mm)[:, None] * (1 - collimator / scanner.sdd)
        at_collimator = off_focal + position * collimator / scanner.sdd
        half = scanner.detectorColCount * scanner.detectorColSize / 2 * collimator / scanner.sdd
        found[spot:] = np.abs(at_collimator) <= half
    return found
