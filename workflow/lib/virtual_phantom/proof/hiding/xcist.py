"""Scans by XCIST/CatSim [1]_, the simulator of the blind validation.

Its projectors, cross-sections, spectra, scatter kernel, crosstalk, lag and noise are used unchanged.
`hiding.hooks` adds physics that XCIST lacks.

References
----------
.. [1] M. Wu et al., Phys. Med. Biol. 67, 194002, 2022.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.optimize import brentq

from ...base.errors import InputError
from ...base.streams import Stream
from ...base.vectors import FLAT
from .materials import MATERIALS, NUMBERS, Attenuation, Material
from .orbits import Orbit

HOOKS = "virtual_phantom.proof.hiding.hooks."
ENERGY_BINS = 20
TARGET_ANGLE_DEG = 7.0  # anode angle of XCIST's tabulated spectra
FOCAL_SPOT_SAMPLES = 3  # per direction, uniformly spaced
SPOT_STRETCHED = (1 - FOCAL_SPOT_SAMPLES**-2) ** -0.5  # gives the samples the variance of a uniform focal spot
ATTEMPTS = 3  # gVirtualXray crashed in 2 of 168 scans, which were complete the next time
ENERGIES_KEV = (40.0, 120.0)  # range of the monochromatic beam's energy
# Neutral settings of the hooks.
IDLE = {
    "detector_columns_px": 0.0,
    "axis_shift_mm": 0.0,
    "velocity_mm_per_s": (0.0, 0.0, 0.0),
    "modulation": (0.0, 0.0),
    "off_focal_share": 0.0,
    "off_focal_width_mm": 20.0,
    "off_focal_collimator_mm": 0.0,  # distance from the focal spot; 0: no collimator
    "heel_depth_mm": 0.0,
    "detector_rows_mm": 0.0,
    "source_mm_per_s": (0.0, 0.0, 0.0),  # along columns, rows and away from the detector
    "angle_wave_deg": (0.0, 0.0),
}


@dataclass(frozen=True)
class Scan(Orbit):
    """A scan for a simulator.

    Attributes
    ----------
    kev : float
        Energy of the monochromatic beam, keV; ignored if the settings contain `kvp`.
    photons : float
        Noise-equivalent quanta per pixel in air, in the center of the detector.
    rotation_ms : float
        Rotation time, ms.
    settings : dict
        {name: value} of the hidden effects: keys of IDLE, and keys that this module, `readout` and `generate` read.
    """

    kev: float = field(kw_only=True)
    photons: float = field(kw_only=True)
    rotation_ms: float = 1000.0
    settings: dict = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """Duration of all views, s."""
        return self.rotation_ms / 1000 * self.turns


@dataclass(frozen=True)
class Acquired:
    """Readings of a scan, in the linear unit of the detector.

    Attributes
    ----------
    readings : ndarray of float32, shape (repeats, views, rows, columns)
    air : ndarray of float32, shape (rows, columns)
    quanta : ndarray, shape (rows, columns), or None
        Noise-equivalent quanta in air, per view; None if unknown.
    current : ndarray, shape (views,), or None
        Relative tube current, by which the readings are divided; None if it is constant.
    """

    readings: np.ndarray
    air: np.ndarray
    quanta: np.ndarray | None = None
    current: np.ndarray | None = None


@dataclass(frozen=True)
class Materials:
    """An object for XCIST: volume fractions of its materials.

    Attributes
    ----------
    fractions : dict of str to ndarray of float32, shape (z, y, x)
        By XCIST's name of the material, in the scanner frame.
    voxel_mm : tuple of 2 float
        Size in the plane and height along z, mm.
    cells_divided : tuple of 2 int
        Columns and rows of parts of a detector cell, whose transmissions are averaged.
    """

    fractions: dict[str, np.ndarray]
    voxel_mm: tuple[float, float]
    cells_divided: tuple[int, int] = (8, 2)

    def configure(self, cfg, folder: Path) -> None:
        """Set the configuration to scan this object; write its files to the folder."""
        cfg.phantom.filename = str(self.write(folder))
        cfg.phantom.projectorCallback = HOOKS + "projector"
        cfg.physics.colSampleCount = cfg.physics.rowSampleCount = 1

    def write(self, folder: Path) -> Path:
        """Write XCIST's files: row 0 at +y, slice 0 at -z, x fastest."""
        names = list(self.fractions)
        slices, rows, columns = self.fractions[names[0]].shape
        plane, height = self.voxel_mm
        files = [f"{number}.raw" for number in range(len(names))]
        content = {"n_materials": len(names), "mat_name": names, "volumefractionmap_filename": files}
        of_each = {
            "volumefractionmap_datatype": "float",
            **{"cols": columns, "rows": rows, "slices": slices},
            **{"x_size": plane, "y_size": plane, "z_size": height},
            **{"x_offset": (columns + 1) / 2, "y_offset": (rows + 1) / 2, "z_offset": (slices + 1) / 2},
        }
        for file, fraction in zip(files, self.fractions.values(), strict=True):
            np.ascontiguousarray(fraction[:, ::-1], np.float32).tofile(folder / file)
        path = folder / "object.json"
        path.write_text(json.dumps(content | {key: [value] * len(names) for key, value in of_each.items()}))
        return path


def write_material(name: str, material: Material, folder: Path) -> str:
    """Write XCIST's file of a material and return its path."""
    lines = [f"{len(material.fractions)}", f"{material.density}"]
    lines += [f"{NUMBERS[symbol]} {share}" for symbol, share in material.fractions.items()]
    path = folder / f"{name}.txt"
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def attenuation_of(kev: float) -> Attenuation:
    """Return a function that gives XCIST's attenuation of a material of MATERIALS, 1/mm."""

    @cache
    def of(name: str) -> float:
        with tempfile.TemporaryDirectory() as folder:
            return attenuation_per_mm(write_material(name, MATERIALS[name], Path(folder)), kev)

    return of


def attenuation_per_mm(material: str, kev: float) -> float:
    """Return XCIST's linear attenuation of a material, 1/mm."""
    from gecatsim.pyfiles.GetMu import GetMu

    return float(GetMu(material, np.array([kev], np.float32))[0]) / 10


def energy_of_water(mu_per_mm: float) -> float:
    """Return the energy at which XCIST's water has an attenuation (1/mm), keV.

    Raises
    ------
    InputError
        If there is no such energy between ENERGIES_KEV.
    """
    most, least = (attenuation_per_mm("water", kev) for kev in ENERGIES_KEV)
    if not least <= mu_per_mm <= most:
        raise InputError(
            f"mu_water_per_mm: the water of the blind validation attenuates {least:.4f} to {most:.4f} per mm "
            f"({ENERGIES_KEV[0]:g} to {ENERGIES_KEV[1]:g} keV), not {mu_per_mm:g}; change it or switch the blind "
            "validation off"
        )
    return brentq(lambda kev: attenuation_per_mm("water", kev) - mu_per_mm, *ENERGIES_KEV)


def simulate(scan: Scan, scanned: Materials, repeats: int, seed: Stream) -> Acquired:
    """Scan Materials or Surfaces in a separate process, since XCIST's library keeps the state of one scan."""
    return isolated(_simulate, scan, scanned, repeats, seed)


def isolated(simulate: Callable[..., Acquired], *arguments) -> Acquired:
    """Return simulate(*arguments), run in a separate process, again if the process crashes.

    Raises
    ------
    InputError
        If the process crashed or was killed in all attempts.
    """
    for left in reversed(range(ATTEMPTS)):
        try:
            with ProcessPoolExecutor(1, get_context("fork")) as pool:
                return pool.submit(simulate, *arguments).result()
        except BrokenProcessPool as error:
            if not left:
                raise InputError(
                    f"the process of the simulator crashed or was killed {ATTEMPTS} times, perhaps because memory ran "
                    "out; run the same command again with fewer cores"
                ) from error


def _simulate(scan, scanned, repeats, seed):
    from .hooks.flux import tube_current

    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)  # the C library prints each allocation
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(io.StringIO()):
        folder = Path(folder)
        cfg = _air(_configured(scan, scanned, folder))
        # Quanta are proportional to the tube current. quantum_kev is the reading per quantum.
        quanta = central(cfg.hooks.quanta, scan)
        current = scan.photons * scan.settings.get("flux_factor", 1.0) / quanta
        quantum_kev = central(cfg.hooks.views[0][0].T, scan) / quanta
        cfg = _air(_configured(scan, scanned, folder, current))
        air, quanta = cfg.hooks.views[0][0], cfg.hooks.quanta.reshape(scan.columns, scan.rows).T
        cfg = _configured(scan, scanned, folder, current, quantum_kev)
        cfg.hooks.repeats = repeats
        cfg.hooks.lag = [None] * repeats
        _seed(cfg, seed.spawn(1)[0])
        cfg.sim.thisScanType = [0, 0, 1, 0]
        _one_scan(cfg)
        current = tube_current(cfg, np.arange(scan.views)) if any(cfg.hooks.modulation) else None
    return Acquired(np.stack(cfg.hooks.views, axis=1), air, quanta, current)


def central(values: np.ndarray, scan: Scan) -> float:
    """Return the mean over the center of the detector of values, shape (columns * rows,), column by column."""
    middle = values.reshape(scan.columns, scan.rows)[(scan.columns - 1) // 2 : scan.columns // 2 + 1]
    return float(middle[:, (scan.rows - 1) // 2 : scan.rows // 2 + 1].mean())


def _air(cfg):
    cfg.sim.thisScanType = [1, 0, 0, 0]
    return _one_scan(cfg)


def _one_scan(cfg):
    from gecatsim.pyfiles.OneScan import one_scan

    return one_scan(cfg)


def _seed(cfg, seed):
    """Seed the quantum noise of XCIST's C library and the electronic noise, which uses NumPy's global state."""
    from gecatsim.pyfiles.C_set_random_seed import C_set_random_seed

    first, second, third = (int(word) for word in seed.generate_state(3) >> 2)
    C_set_random_seed(cfg, first + 1, second + 1)
    np.random.seed(third)  # noqa: NPY002


def _configured(scan: Scan, scanned: Materials, folder: Path, current: float = 1.0, quantum_kev: float = 0.0):
    from gecatsim import CFG

    cfg = CFG()
    settings = IDLE | scan.settings
    physics, scanner, protocol = cfg.physics, cfg.scanner, cfg.protocol
    scanned.configure(cfg, folder)
    cfg.phantom.projectorNumThreads = 1
    scanner.sid = scan.source_to_isocentre_mm + settings.get("isocentre_mm", 0.0)
    scanner.sdd = scan.source_to_detector_mm + settings.get("detector_mm", 0.0)
    scanner.detectorColCount = scan.columns
    scanner.detectorColsPerMod = scan.columns if scan.surface == FLAT else 1  # a single module is flat
    scanner.detectorRowsPerMod = scanner.detectorRowCount = scan.rows
    scanner.detectorColSize, scanner.detectorRowSize = scan.column_pitch_mm, scan.row_pitch_mm
    scanner.detectorColOffset = scan.column_offset_px + settings["detector_columns_px"]
    scanner.detectorRowOffset = settings["detector_rows_mm"] / scan.row_pitch_mm
    scanner.detectorColFillFraction = scanner.detectorRowFillFraction = 1.0
    scanner.detectorPrefilter = []
    scanner.detectionGain = 1.0
    scanner.detectionCallback = HOOKS + "detection"
    scanner.focalspotCallback = HOOKS + "source"
    scanner.focalspotShape = "uniform"
    scanner.targetAngle = TARGET_ANGLE_DEG
    protocol.scanTrajectory = HOOKS + "gantry"
    protocol.viewsPerRotation, protocol.viewCount = scan.views_per_rotation, scan.views
    protocol.stopViewId = scan.views - 1
    protocol.rotationTime = scan.rotation_ms / 1000
    protocol.mA = current
    protocol.flatFilter = []
    protocol.bowtie = "" if "bowtie" not in settings else _scaled_bowtie(settings, folder)
    protocol.wobbleDistance = settings.get("wobble_mm", 0.0)
    protocol.dutyRatio = settings.get("duty", 1.0)
    # XCIST exposes from the start of a view's interval; recordings give the angle at the middle of the exposure.
    protocol.startAngle = scan.start_angle_deg + 360 / scan.views_per_rotation * (1 - protocol.dutyRatio) / 2
    # XCIST moves the table instead of the source.
    protocol.startZ, protocol.tableSpeed = -scan.start_z_mm, -scan.feed_mm / protocol.rotationTime
    physics.fluxCallback = HOOKS + "flux"
    physics.recalcFlux = 1
    physics.outputCallback = HOOKS + "output"
    physics.viewSampleCount = settings.get("subviews", 1)
    if "kvp" in settings:
        physics.energyCount = ENERGY_BINS
        protocol.spectrumFilename = f"tungsten_tar{TARGET_ANGLE_DEG:.1f}_{settings['kvp']:.0f}_filt.dat"
        protocol.flatFilter = ["Al", settings["aluminium_mm"], *settings.get("plate", ())]
    else:
        physics.energyCount = 1
        physics.monochromatic = scan.kev
    width, length = settings.get("focal_spot_mm", (0.0, 0.0))
    samples = FOCAL_SPOT_SAMPLES if width or length else 1
    physics.srcXSampleCount = physics.srcYSampleCount = samples
    scanner.focalspotWidth, scanner.focalspotLength = (max(SPOT_STRETCHED * side, 1e-3) for side in (width, length))
    if "scatter_scale" in settings:
        physics.scatterCallback = "Scatter_ConvolutionModel"
        physics.scatterScaleFactor = settings["scatter_scale"]
    if "crosstalk" in settings:
        physics.crosstalkCallback = "CalcCrossTalk"
        physics.col_crosstalk, physics.row_crosstalk = settings["crosstalk"]
    if "optical_crosstalk" in settings:
        physics.opticalCrosstalkCallback = "CalcOptCrossTalk"
        physics.col_crosstalk_opt, physics.row_crosstalk_opt = settings["optical_crosstalk"]
    if "lag_share" in settings:
        physics.lagCallback = "Detection_Lag"
        physics.lag_taus = [np.float32(settings["lag_ms"]), np.float32(settings.get("slow_lag_ms", 1.0))]
        physics.lag_alphas = [settings["lag_share"], settings.get("slow_lag_share", 0.0)]
    physics.enableElectronicNoise = int("electronic_photons" in settings)
    scanner.eNoise = settings.get("electronic_photons", 0.0) * quantum_kev
    cfg.hooks = SimpleNamespace(
        **settings,
        cells_divided=scanned.cells_divided,
        views=[],
        lag=[None],
        current=1.0,
        repeats=1,
        quanta=None,
        photons=None,
    )
    return cfg


def _scaled_bowtie(settings: dict, folder: Path) -> str:
    """Write one of XCIST's bowtie filters with scaled thicknesses."""
    from gecatsim.pyfiles.CommonTools import my_path

    table = np.loadtxt(my_path.find("bowtie", settings["bowtie"], ".txt"), comments=["#", "%"])
    table[:, 1:] *= settings["bowtie_scale"]
    path = folder / "bowtie.txt"
    np.savetxt(path, table)
    return str(path)
