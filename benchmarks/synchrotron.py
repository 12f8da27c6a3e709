"""Diagnose a simulated synchrotron scan with three energies, blur and phase contrast (3 minutes).

An off-center wire of aluminum, 1 mm across, is scanned in a parallel beam with pixels of 2.5 um over half a turn. The
wave behind the object is propagated by the Fresnel integral, in plain NumPy, for each energy. Prints the verdict of
each case: with each effect alone, with all, and with none. The simulation that is compared has one energy, no blur and
no phase contrast.

References
----------
D. M. Paganin, Coherent X-Ray Optics, Oxford University Press, 2006: propagation, and the refractive index decrement.
"""

import tempfile
from pathlib import Path

import numpy as np
import xraylib
from scipy.ndimage import gaussian_filter1d

import virtual_phantom as vp
from virtual_phantom.recordings.importers.projections import import_projections

ONE_THREAD = True
COLUMNS, VIEWS, PIXEL_UM, FINE = 640, 90, 2.5, 8
DIAMETER_MM, CENTRE_MM = 1.0, (0.06, -0.03)
ENERGIES_KEV, SHARES = (20.0, 30.0, 45.0), (0.6, 0.3, 0.1)
DISTANCE_MM, BLUR_PX, PHOTONS, DARK = 30.0, 1.2, 2e4, 100.0
DENSITY, ELECTRON_RADIUS_MM, ELECTRONS_PER_MM3 = 2.70, 2.8179e-12, 2.70 * 6.02214e20 * 13 / 26.98
CASES = {
    "nothing": {},
    "three energies": {"energies": True},
    "blur": {"blur": True},
    "phase contrast": {"phase": True},
    "all three": {"energies": True, "blur": True, "phase": True},
}


def lengths_mm():
    """Path lengths through the wire on a grid FINE times finer than the pixels, (views, samples)."""
    pixel = PIXEL_UM / 1000 / FINE
    position = (np.arange(COLUMNS * FINE) - (COLUMNS * FINE - 1) / 2) * pixel
    angle = np.pi * np.arange(VIEWS) / VIEWS
    shadow = CENTRE_MM[0] * np.cos(angle) + CENTRE_MM[1] * np.sin(angle)
    return 2 * np.sqrt(np.maximum((DIAMETER_MM / 2) ** 2 - (position - shadow[:, None]) ** 2, 0))


def intensity(lengths, energy_kev, phase):
    """Intensity at the detector relative to air."""
    attenuation = 0.1 * DENSITY * xraylib.CS_Total(13, energy_kev)  # 1/mm
    if not phase:
        return np.exp(-attenuation * lengths)
    wavelength = 1.23984e-6 / energy_kev  # mm
    shift = wavelength * ELECTRON_RADIUS_MM * ELECTRONS_PER_MM3 * lengths  # 2 pi / wavelength times delta times length
    wave = np.exp(-attenuation * lengths / 2 + 1j * -shift)
    frequency = np.fft.fftfreq(lengths.shape[1], PIXEL_UM / 1000 / FINE)
    kernel = np.exp(-1j * np.pi * wavelength * DISTANCE_MM * frequency**2)
    return np.abs(np.fft.ifft(np.fft.fft(wave) * kernel)) ** 2


def counts(random, energies=False, blur=False, phase=False):
    """Counts (views, rows, columns), flat field and dark field."""
    lengths = lengths_mm()
    shares = SHARES if energies else (1.0,)
    signal = sum(s * intensity(lengths, e, phase) for s, e in zip(shares, ENERGIES_KEV, strict=False))
    signal = signal.reshape(VIEWS, COLUMNS, FINE).mean(axis=2)
    if blur:
        signal = gaussian_filter1d(signal, BLUR_PX, axis=1)
    data = random.poisson(PHOTONS * signal).astype(float) + DARK
    return data[:, None].astype(np.uint16), np.full((1, COLUMNS), PHOTONS + DARK), np.full((1, COLUMNS), DARK)


def recorded(folder, random, repeats=2, **physics):
    """Recording of `repeats` scans, through the importer."""
    stacks = [counts(random, **physics) for _ in range(repeats)]
    names = [folder / f"{name}.npy" for name in ("data", "flat", "dark")]
    for path, array in zip(names, (stacks[0][0], *stacks[0][1:]), strict=True):
        np.save(path, array)
    options = {"flat": str(names[1]), "dark": str(names[2]), "angles": f"0,{180 / VIEWS}", "beam": "parallel"}
    import_projections(names[0], folder / "scan", **options, pixel=[PIXEL_UM], unit="um", energy_kev=ENERGIES_KEV[0])
    return folder / "scan"


def run(options):
    for index, (name, physics) in enumerate(CASES.items()):
        with tempfile.TemporaryDirectory() as folder:
            random = np.random.default_rng(np.random.SeedSequence((1, index)))
            found = vp.diagnose(
                recorded(Path(folder), random, **physics),
                disc=(DIAMETER_MM, "aluminium"),
                alignment={"scale": 0.02, "x_mm": 0.05, "y_mm": 0.05},
            )
        print(f"--- {name}")
        print("\n".join([found.content["verdict"], *found.content["verdict_lines"]]), flush=True)
