"""XCIST's projection on subdivided detector cells, with averaged transmissions.

XCIST's distance-driven projector of voxels averages path lengths over a cell, while a detector adds up photons. Its
projector of surfaces traces single rays. Smaller cells reduce both errors.
"""

import copy

import numpy as np
from gecatsim.pyfiles.C_Projector_Analytic import C_Projector_Analytic
from gecatsim.pyfiles.C_Projector_SetData import set_detector_analytic, set_detector_voxelized, set_source_analytic
from gecatsim.pyfiles.C_Projector_Voxelized import C_Projector_Voxelized
from gecatsim.pyfiles.Detector_ThirdgenCurved import Detector_ThirdgenCurved

from ..faults import displaced_tile
from .source import seen


def projector(cfg, view, subview):
    """Multiply `cfg.thisSubView`, shape (cells, energies), by the mean transmission over each cell."""
    by_column, by_row = cfg.hooks.cells_divided
    of_surfaces = cfg.phantom.callback == "Phantom_Analytic"
    if view == cfg.sim.startViewId and subview == 0:
        cfg.hooks.fine = _divided(cfg, by_column, by_row)
        # XCIST's C library projects onto these cells from here on.
        (set_detector_analytic if of_surfaces else set_detector_voxelized)(cfg.hooks.fine)
    fine, scanner = cfg.hooks.fine, cfg.scanner
    finer = copy.copy(cfg)
    finer.detNew = copy.copy(cfg.detNew)
    finer.detNew.totalNumCells, finer.detNew.startIndices = fine.det.totalNumCells, fine.det.startIndices
    finer.thisSubView = np.ones((fine.det.totalNumCells, cfg.spec.nEbin), np.float32)
    project = C_Projector_Analytic if of_surfaces else C_Projector_Voxelized
    if cfg.hooks.beside_mm:  # off-focal points, which not every cell sees: weights per cell
        finer.srcNew = copy.copy(cfg.srcNew)
        cells = np.repeat(seen(cfg, by_column), scanner.detectorRowCount * by_row, axis=1)
        finer.srcNew.weights = (cfg.src.weights[0][:, None] * cells)[None, :, :, None]
        project = _by_points if of_surfaces else project
    transmission = project(finer, view, subview).thisSubView
    settings = vars(cfg.hooks)
    if shift := settings.get("tile_px", 0.0):
        columns = transmission.reshape(scanner.detectorColCount * by_column, -1)
        moved = displaced_tile(columns, settings["tile_from"], settings["tile_to"], shift * by_column)
        transmission = moved.reshape(transmission.shape)
    shape = scanner.detectorColCount, by_column, scanner.detectorRowCount, by_row, cfg.spec.nEbin
    mean = transmission.reshape(shape).mean(axis=(1, 3)).reshape(-1, cfg.spec.nEbin)
    if cfg.hooks.beside_mm:  # already part of the flux
        mean = mean / cfg.hooks.open
    cfg.thisSubView = cfg.thisSubView * mean
    return cfg


def _by_points(cfg, view, subview):
    """Project surfaces from every point of the source: XCIST's weights of points are the same for all cells."""
    weights, total = cfg.srcNew.weights[0, :, :, 0], 0.0
    for point, weight in zip(cfg.srcNew.samples, weights, strict=True):
        one = copy.copy(cfg)
        one.srcNew, one.thisSubView = copy.copy(cfg.srcNew), np.ones_like(cfg.thisSubView)
        one.srcNew.samples, one.srcNew.nSamples, one.srcNew.weights = point[None], 1, np.ones((1, 1))
        one.srcNew.corners, one.srcNew.nCorners = point[None], 1  # which tell where objects may have a shadow
        one.src = one.srcNew
        set_source_analytic(one)
        total = total + weight[:, None] * C_Projector_Analytic(one, view, subview).thisSubView
    cfg.thisSubView = cfg.thisSubView * total
    return cfg


def _divided(cfg, by_column, by_row):
    """Return a configuration whose detector has the same size and so many times as many columns and rows."""
    finer = copy.copy(cfg)
    finer.scanner = scanner = copy.copy(cfg.scanner)
    finer.det = None
    modules = cfg.scanner.detectorColCount // cfg.scanner.detectorColsPerMod
    scanner.detectorColCount = cfg.scanner.detectorColCount * by_column
    scanner.detectorColsPerMod = scanner.detectorColCount // modules
    scanner.detectorRowsPerMod = scanner.detectorRowCount = cfg.scanner.detectorRowCount * by_row
    scanner.detectorColSize = cfg.scanner.detectorColSize / by_column
    scanner.detectorRowSize = cfg.scanner.detectorRowSize / by_row
    return Detector_ThirdgenCurved(finer)
