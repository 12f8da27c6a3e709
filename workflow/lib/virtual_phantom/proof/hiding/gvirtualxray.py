"""Scans by gVirtualXray [1]_, the second simulator of the blind validation.

gVirtualXray computes the primary transmission of surface meshes. This module adds source, scatter, detector and noise,
by other equations than the library's.

References
----------
.. [1] J. L. Pointon et al., Comput. Methods Programs Biomed. 234, 107500, 2023.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from functools import cache
from itertools import product

import numpy as np
import xraylib
from scipy import signal
from scipy.optimize import brentq

from ...base.errors import InputError
from ...base.streams import Stream, generator
from .faults import displaced_tile, refracted
from .materials import MATERIALS, NUMBERS, Attenuation, Material, mixed
from .meshes import meshes
from .objects import ScannedObject
from .tube import heel, modulated
from .unsteady import displacement, turned
from .xcist import (
    ENERGIES_KEV,
    ENERGY_BINS,
    FOCAL_SPOT_SAMPLES,
    SPOT_STRETCHED,
    TARGET_ANGLE_DEG,
    Acquired,
    Scan,
    isolated,
)

# Most rays per pixel and image along columns and rows. Edges of rods along z need many along the columns: images are
# the mean of two with the detector displaced by these shares of the distance between rays.
DIVIDED, DISPLACED = (16, 2), (-0.25, 0.25)
MOST_RAYS = 2048  # in a row of an image, the limit of gVirtualXray with Mesa
SCINTILLATOR_MM, SCINTILLATOR = 0.6, (4.51, {55: 0.5115, 53: 0.4885})  # caesium iodide: g/cm3, mass fractions
TUNGSTEN = 74
SCATTER_PER_SCALE = 0.02  # scattered over primary signal times its line integral at a scale of 1
CROSSTALK_REACH = 3  # pixels
LAG_TERMS = 5  # exponentials that approximate the decay of traps


def mass_attenuation(fractions: Mapping[int, float], kev: float) -> float:
    """Return the mass attenuation of a mixture of elements, cm2/g."""
    return sum(share * xraylib.CS_Total(number, float(kev)) for number, share in fractions.items())


def _of(material: Material, kev: float) -> float:
    elements = {NUMBERS[symbol]: share for symbol, share in material.fractions.items()}
    return mass_attenuation(elements, kev) * material.density / 10


def attenuation_of(kev: float) -> Attenuation:
    """Return a function that gives the attenuation of a material of MATERIALS, 1/mm."""
    return cache(lambda name: _of(MATERIALS[name], kev))


def energy_of_water(mu_per_mm: float) -> float:
    """Return the energy at which water has an attenuation (1/mm), keV."""
    return brentq(lambda kev: _of(MATERIALS["water"], kev) - mu_per_mm, *ENERGIES_KEV)


def simulate(scan: Scan, scanned: ScannedObject, mu_water_per_mm: float, repeats: int, seed: Stream) -> Acquired:
    """Scan an object in a separate process, since gVirtualXray keeps one scene."""
    return isolated(_simulate, scan, scanned, mu_water_per_mm, repeats, seed)


def _simulate(scan, scanned, mu_water_per_mm, repeats, seed):
    energies, photons = spectrum(scan)
    transmission = _transmission(scan, scanned, mu_water_per_mm, energies)
    field = _field(scan, energies)
    absorbed = photons * field  # (rows, columns, energies)
    middle = absorbed[(scan.rows - 1) // 2 : scan.rows // 2 + 1, (scan.columns - 1) // 2 : scan.columns // 2 + 1]
    quanta = ((middle @ energies) ** 2 / (middle @ energies**2)).mean()
    reading_per_quantum = float((middle @ energies).mean() / quanta)
    absorbed *= scan.photons * scan.settings.get("flux_factor", 1.0) / quanta  # and `middle`, which is a view
    mean, air = transmission * absorbed, absorbed[None]
    current = None
    if any(scan.settings.get("modulation", (0.0, 0.0))):
        angle = np.deg2rad(scan.start_angle_deg) + 2 * np.pi * np.arange(scan.views) / scan.views_per_rotation
        current = modulated(angle, *scan.settings["modulation"])
        mean = mean * current[:, None, None, None]
    if amount := scan.settings.get("refraction", 0.0):
        mean = np.stack([refracted(view.swapaxes(0, 1), amount).swapaxes(0, 1) for view in mean])
    mean = scattered(mean, air, scan)
    mean, air = (shared(counts, *scan.settings.get("crosstalk", (0.0, 0.0))) for counts in (mean, air))
    random = generator(seed)
    readings = np.stack([random.poisson(np.maximum(mean, 0)) @ energies for _ in range(repeats)])
    air = air[0] @ energies
    if "optical_crosstalk" in scan.settings:
        readings, air = (
            shared(values[..., None], *scan.settings["optical_crosstalk"])[..., 0] for values in (readings, air)
        )
    readings = lagging(readings, scan)
    if noise := scan.settings.get("electronic_photons", 0.0):
        readings = readings + random.normal(0, noise * reading_per_quantum, readings.shape)
    if current is not None:
        readings = readings / current[:, None, None]
    return Acquired(readings.astype(np.float32), air.astype(np.float32), current=current)


def spectrum(scan: Scan) -> tuple[np.ndarray, np.ndarray]:
    """Return energies (keV) and the relative numbers of photons that the scintillator absorbs."""
    if "kvp" not in scan.settings:
        return np.array([scan.kev]), np.ones(1)
    from gecatsim.pyfiles.CommonTools import my_path

    name = f"tungsten_tar7.0_{scan.settings['kvp']:.0f}_filt.dat"  # XCIST's table of a tungsten tube
    table = np.loadtxt(my_path.find("spectrum", name, ""), delimiter=",", skiprows=1)
    bins = np.array_split(table[table[:, 0] > 15], ENERGY_BINS)
    photons = np.array([part[:, 1].sum() for part in bins])
    energies = np.array([np.average(part[:, 0], weights=part[:, 1] + 1e-12) for part in bins])
    aluminium = np.array([xraylib.CS_Total(13, energy) * 2.699 / 10 for energy in energies])
    density, fractions = SCINTILLATOR
    absorption = np.array([mass_attenuation(fractions, energy) * density / 10 for energy in energies])
    filtered = photons * np.exp(-aluminium * scan.settings["aluminium_mm"])
    return energies, filtered * -np.expm1(-absorption * SCINTILLATOR_MM)


def _field(scan: Scan, energies: np.ndarray) -> np.ndarray:
    """Return the relative fluence of every pixel, shape (rows, columns, energies): solid angle and heel effect."""
    u = (np.arange(scan.columns) - (scan.columns - 1) / 2 + scan.column_offset_px) * scan.column_pitch_mm
    v = (np.arange(scan.rows) - (scan.rows - 1) / 2) * scan.row_pitch_mm
    distance = scan.source_to_detector_mm
    field = (1 + (u**2 + v[:, None] ** 2) / distance**2)[..., None] ** -1.5 * np.ones(len(energies))
    if depth := scan.settings.get("heel_depth_mm", 0.0):
        mu = np.array([xraylib.CS_Total(TUNGSTEN, float(energy)) * 19.3 / 10 for energy in energies])
        field = field * heel(np.arctan(v / distance), depth, TARGET_ANGLE_DEG, mu)[:, None]
    return field


def scattered(mean: np.ndarray, air: np.ndarray, scan: Scan) -> np.ndarray:
    """Add scatter of first order from the depth of the isocenter.

    A point source at a distance h from the detector gives an irradiance in proportion to (h^2 + r^2)^(-3/2).
    """
    scale = scan.settings.get("scatter_scale", 0.0)
    if not scale:
        return mean
    gap = scan.source_to_detector_mm - scan.source_to_isocentre_mm
    u = np.arange(1 - scan.columns, scan.columns) * scan.column_pitch_mm
    v = np.arange(1 - scan.rows, scan.rows) * scan.row_pitch_mm
    kernel = (gap**2 + u**2 + v[:, None] ** 2) ** -1.5
    total = mean.sum(axis=-1)
    source = total * np.log(np.maximum(air.sum(axis=-1) / np.maximum(total, 1e-9), 1))
    # Relative to what the detector sees of the kernel, so that the share does not depend on its height.
    wide = signal.fftconvolve(source, kernel[None], mode="same", axes=(1, 2)) / kernel.sum()
    share = mean.sum(axis=(1, 2), keepdims=True) / total.sum(axis=(1, 2))[:, None, None, None]
    return mean + SCATTER_PER_SCALE * scale * wide[..., None] * share


def shared(counts: np.ndarray, column: float, row: float) -> np.ndarray:
    """Spread counts, shape (..., rows, columns, energies), over several neighbors.

    Light from a point at depth h in the scintillator, with h = 1 pixel, gives an irradiance on the photodiodes in
    proportion to h (h^2 + r^2)^(-3/2). Its integral along the other axis, the line spread function, is in proportion to
    1 / (h^2 + x^2). `column` and `row` are the sums of the shares on either side, up to CROSSTALK_REACH.
    """
    for axis, share in ((-2, column), (-3, row)):
        if share:
            side = 1 / (1 + np.arange(1, CROSSTALK_REACH + 1) ** 2)
            side *= share / side.sum()
            kernel = np.concatenate([side[::-1], [1 - 2 * share], side])
            shape = [1] * counts.ndim
            shape[axis] = len(kernel)
            counts = signal.oaconvolve(counts, kernel.reshape(shape), mode="same", axes=axis)
    return counts


def lagging(readings: np.ndarray, scan: Scan) -> np.ndarray:
    """Add the light that traps emit late: decay times that spread around the stated one, by a factor of 2 on each side.

    The scan begins without afterglow.

    Parameters
    ----------
    readings : ndarray, shape (repeats, views, rows, columns)
    """
    share = scan.settings.get("lag_share", 0.0)
    if not share:
        return readings
    interval = scan.rotation_ms / scan.views_per_rotation
    found = (1 - share) * readings
    for time in scan.settings["lag_ms"] * np.geomspace(0.5, 2, LAG_TERMS):
        # A flash in the middle of each interval: the rest of its light appears in the following intervals.
        memory = np.exp(-interval / time)
        here, later = -np.expm1(-interval / 2 / time), np.exp(-interval / 2 / time) * (1 - memory)
        weight, state = share / LAG_TERMS, np.zeros_like(readings[:, 0])
        for view in range(readings.shape[1]):
            found[:, view] += weight * (here * readings[:, view] + later * state)
            state = memory * state + readings[:, view]
    return found


def _transmission(scan: Scan, scanned: ScannedObject, mu_water_per_mm: float, energies: np.ndarray) -> np.ndarray:
    """Return the transmission averaged over source, pixel and exposure, shape (views, rows, columns, energies)."""
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa
    with _quiet():
        try:
            from gvxrPython3 import gvxr
        except ImportError as error:  # it links to libraries of the system
            raise InputError(
                f"gVirtualXray does not start ({error}); install the Debian packages listed in environment-proof.txt"
            ) from None
        gvxr.createWindow(-1, 0, "EGL", 4, 5)
        attenuation = attenuation_of(scan.kev)
        for number, (part, vertices, triangles) in enumerate(meshes(scanned)):
            amounts = part.amounts(attenuation, mu_water_per_mm)
            if not amounts:
                continue
            name = f"part{number}"
            gvxr.makeTriangularMesh(name, vertices.ravel().tolist(), triangles.ravel().tolist(), "mm")
            made = mixed(amounts)
            numbers = [NUMBERS[symbol] for symbol in made.fractions]
            gvxr.setMixture(name, numbers, list(made.fractions.values()))
            gvxr.setDensity(name, made.density, "g/cm3")
            gvxr.addPolygonMeshAsInnerSurface(name)
        gvxr.usePointSource()
        columns, rows = _divided(scan)
        gvxr.setDetectorNumberOfPixels(scan.columns * columns, scan.rows * rows)
        gvxr.setDetectorPixelSize(scan.column_pitch_mm / columns, scan.row_pitch_mm / rows, "mm")
        found = np.zeros((scan.views, scan.rows, scan.columns, len(energies)))
        for number, energy in enumerate(energies):
            gvxr.setMonoChromatic(float(energy), "keV", 1)
            for view in range(scan.views):
                rays = _rays(scan, view)
                for (source, detector, along), share in product(rays, DISPLACED):
                    place = detector + share * scan.column_pitch_mm / columns * along
                    gvxr.setSourcePosition(*source.tolist(), "mm")
                    gvxr.setDetectorPosition(*place.tolist(), "mm")
                    gvxr.setDetectorRightVector(*along.tolist())
                    gvxr.setDetectorUpVector(0.0, 0.0, 1.0)
                    image = np.array(gvxr.computeXRayImage()) * 1000 / energy  # the unit of energy is MeV
                    found[view, :, :, number] += _cells(image, scan) / len(rays) / len(DISPLACED)
        gvxr.destroy()
    return found


def _divided(scan: Scan) -> tuple[int, int]:
    """Return the rays per pixel along columns and rows."""
    return max(1, min(DIVIDED[0], MOST_RAYS // scan.columns)), DIVIDED[1]


def _cells(image: np.ndarray, scan: Scan) -> np.ndarray:
    """Average an image on divided pixels over each pixel, shape (rows, columns)."""
    columns, rows = _divided(scan)
    if shift := scan.settings.get("tile_px", 0.0):
        ends = scan.settings["tile_from"], scan.settings["tile_to"]
        image = displaced_tile(image.T, *ends, shift * columns).T
    return image.reshape(scan.rows, rows, scan.columns, columns).mean(axis=(1, 3))


def _rays(scan: Scan, view: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return positions of source points and detector, mm, and the direction of growing columns."""
    settings = scan.settings
    subviews = settings.get("subviews", 1)
    found = []
    for part in range(subviews):
        within = settings.get("duty", 1.0) * ((part + 0.5) / subviews - 0.5)
        turns = (view + within) / scan.views_per_rotation
        found += _points(scan, view, turns)
    return found


def _points(scan: Scan, view: int, turns: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    settings, angle = scan.settings, np.deg2rad(scan.start_angle_deg) + 2 * np.pi * turns
    to_source, along = np.array([-np.sin(angle), np.cos(angle), 0.0]), np.array([np.cos(angle), np.sin(angle), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    near = scan.source_to_isocentre_mm + settings.get("isocentre_mm", 0.0)
    far = scan.source_to_detector_mm + settings.get("detector_mm", 0.0)
    height = up * (scan.start_z_mm + scan.feed_mm * turns)
    offset = scan.column_offset_px + settings.get("detector_columns_px", 0.0)
    detector = (near - far) * to_source + height + offset * scan.column_pitch_mm * along
    detector = detector + settings.get("detector_rows_mm", 0.0) * up
    source = near * to_source + height + (2 * (view % 2) - 1) * settings.get("wobble_mm", 0.0) * along
    moved = displacement(settings, view, scan.views, turns, scan.duration_s, along, up)
    width, length = settings.get("focal_spot_mm", (0.0, 0.0))
    count = FOCAL_SPOT_SAMPLES if width or length else 1
    steps = SPOT_STRETCHED * ((np.arange(count) + 0.5) / count - 0.5)
    slope = np.tan(np.deg2rad(TARGET_ANGLE_DEG))
    found = []
    for across in steps * width:
        for high in steps * length:
            # The end at +z of an inclined target is nearer to the isocenter.
            point = source + across * along + high * up - high / slope * to_source
            place = np.stack([point + moved.source_mm, detector]) - moved.object_mm
            place = turned(place, moved.turn_deg)
            found.append((*place, turned(along[None], moved.turn_deg)[0]))
    return found


@contextlib.contextmanager
def _quiet():
    """Send the messages of the C++ library to nowhere."""
    kept = [os.dup(number) for number in (1, 2)]
    with open(os.devnull, "w") as nowhere:
        for number in (1, 2):
            os.dup2(nowhere.fileno(), number)
        try:
            yield
        finally:
            for number, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, number)
                os.close(copy)
