"""Compare the image quality of a Catphan 504 with that of pylinac (2 minutes).

The folder DICOM holds one scan, such as the demonstration data of pylinac. Prints Markdown tables: HU and uniformity by
`snakemake image_quality` in the slices that pylinac uses, and pylinac's own methods for line pairs and the noise power
spectrum, repeated without its code. The task transfer function of the air inserts is printed beside the line pairs.
"""

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.signal import find_peaks

from virtual_phantom.diagnosis.settings import ShapesObject
from virtual_phantom.image_quality.location import layout, locate
from virtual_phantom.image_quality.measure import measure_module
from virtual_phantom.image_quality.settings import ModuleSettings
from virtual_phantom.phantom.ct import read_hu
from virtual_phantom.physics.scenes.objects import read_object

INSERTS = {
    **{"Air": "air_top", "PMP": "pmp", "LDPE": "ldpe", "Poly": "polystyrene"},
    **{"Acrylic": "acrylic", "Delrin": "delrin", "Teflon": "teflon"},
}
LINE_PAIRS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # per mm
# Ends of the sectors of the line pairs (turns), number of bars, and smallest distance of bars (turns): pylinac 3.49.0
SECTORS = (0, 0.107, 0.173, 0.236, 0.286, 0.335, 0.387, 0.434, 0.479)
BARS = (2, 3, 4, 4, 4, 5, 5, 5)
DISTANCE = (0.021, 0.01, 0.006, 0.00557, 0.004777, 0.00398, 0.00358, 0.0027866)
RADIUS_MM, WIDTH = 47.0, 0.04  # of the circle of line pairs; relative width of its band
NPS_MM, NPS_AWAY_MM = 10.0, 53.0  # half-side and distance of the squares of the noise power spectrum


def add_arguments(parser):
    parser.add_argument("dicom", type=Path, help="folder of the scan")


def peaks(profile, count, distance):
    """Return the positions of the most prominent peaks."""
    positions, found = find_peaks(profile, distance=max(distance, 1), prominence=0)
    return np.sort(positions[np.argsort(-found["prominences"])[:count]])


def line_pairs(plane, spacing, center, roll_deg):
    """Return the modulation of each line pair relative to the first: the largest of seven slices, on a circle."""
    step = 1 / (4 * np.pi * (1 + WIDTH) * RADIUS_MM / spacing[1])  # two samples per pixel of the largest circle
    turn = np.arange(0, 1, step)
    # From the left of the display, counter-clockwise. The axes of a display run against +x and +y.
    angle = np.pi + np.radians(roll_deg) - 2 * np.pi * turn
    radii = np.linspace(1 - WIDTH, 1 + WIDTH, 20) * RADIUS_MM
    x, y = np.outer(radii, -np.cos(angle)), np.outer(radii, -np.sin(angle))
    rows, columns = (
        (place + at) / pitch + (n - 1) / 2
        for place, at, pitch, n in zip((y, x), center[::-1], spacing[1:], plane.shape, strict=True)
    )
    profile = ndimage.map_coordinates(plane, [rows, columns], order=0).mean(axis=0)  # nearest pixels, as pylinac
    profile = ndimage.gaussian_filter1d(profile, 1)
    profile -= profile.min()
    found = []
    for first, last, bars, distance in zip(SECTORS[:-1], SECTORS[1:], BARS, DISTANCE, strict=True):
        part = profile[int(first / step) : int(last / step)]
        tops = peaks(part, bars, distance / step)
        inside = part[tops[0] : tops[-1]]
        low, high = inside[peaks(-inside, bars - 1, distance / step)].mean(), part[tops].mean()
        found.append((high - low) / (high + low))
    return np.array(found) / found[0]


def noise_spectrum(plane, spacing, center):
    """Return the radial mean of the periodograms of five squares of 20 mm (ICRU Report 87, equation 11.1)."""
    half, middle = int(round(NPS_MM / spacing[1])), (np.array(plane.shape) - 1) / 2
    powers = []
    for dx, dy in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        x = int(round(middle[1] + (center[0] + dx * NPS_AWAY_MM) / spacing[2]))
        y = int(round(middle[0] + (center[1] + dy * NPS_AWAY_MM) / spacing[1]))
        square = plane[y - half : y + half + 1, x - half : x + half + 1]
        powers.append(np.abs(np.fft.fftshift(np.fft.fft2(square - square.mean()))) ** 2)
    side = 2 * half + 1
    power = np.mean(powers, axis=0) * spacing[1] ** 2 / side**2
    rows, columns = np.indices(power.shape) - side // 2
    ring = np.hypot(rows, columns).astype(int).ravel()
    return np.bincount(ring, power.ravel()) / np.bincount(ring)


def run(options):
    try:
        import pylinac
    except ImportError:
        print("pylinac is not installed; install it in a separate environment: pip install pylinac", file=sys.stderr)
        return 1
    phantom = pylinac.CatPhan504(str(options.dicom))
    phantom.analyze()
    volume = read_hu(options.dicom)
    grid, spacing = volume.grid, volume.grid.spacing
    z = grid.centre_mm[2] + grid.axes_mm()[0]

    def measured(kind, number):
        heights = (float(z[number]) - 0.1, float(z[number]) + 0.1)
        return measure_module([volume.array], grid, ModuleSettings(ShapesObject(kind), heights))[0]

    print(f"pylinac {pylinac.__version__}\n")
    print("| CT number (HU) | pylinac | here, same slice | here, whole module |\n|---|---|---|---|")
    same = measured("catphan504_ctp404", phantom.ctp404.slice_num)
    whole = measure_module([volume.array], grid, ModuleSettings(ShapesObject("catphan504_ctp404")))[0]
    here, all_slices = ({one["insert"]: one for one in found["inserts"]} for found in (same, whole))
    for name, insert in INSERTS.items():
        pair = here[insert]["hu"], all_slices[insert]["hu"]
        print(f"| {insert} | {phantom.ctp404.rois[name].pixel_value:.1f} | {pair[0]:.1f} | {pair[1]:.1f} |")
    regions = measured("catphan504_ctp486", phantom.ctp486.slice_num)["uniformity"]["regions"]
    # Directions of pylinac are those of the display: its left is +x, as here.
    for name, roi in phantom.ctp486.rois.items():
        print(f"| uniformity, {name.lower()} | {roi.pixel_value:.1f} | {regions[name.lower()]:.1f} | |")

    known = layout(read_object("catphan504_ctp404"))
    found = locate(volume.array[phantom.ctp404.slice_num][None], spacing, known)
    number = phantom.ctp528.slice_num
    body = layout(read_object("catphan504_ctp486"))
    center = locate(volume.array[number][None], spacing, body).centers[0]
    pairs = line_pairs(volume.array[number - 3 : number + 4].max(axis=0), spacing, center, found.roll_deg)
    air = all_slices["air_top"], all_slices["air_bottom"]
    print("\n| line pairs per mm | pylinac | its method repeated | difference |\n|---|---|---|---|")
    for frequency, value in zip(LINE_PAIRS, pairs, strict=True):
        other = phantom.ctp528.mtf.norm_mtfs[frequency]
        print(f"| {frequency} | {other:.3f} | {value:.3f} | {100 * (value / other - 1):+.1f} % |")
    fifty = np.interp(-0.5, -pairs, LINE_PAIRS)
    print(f"| 50 % at | {phantom.ctp528.mtf.relative_resolution(50):.3f} | {fifty:.3f} | |")
    print(f"\nTTF of the air inserts: 50 % at {air[0]['f50_per_mm']:.3f} and {air[1]['f50_per_mm']:.3f} per mm")

    number = phantom.ctp486.slice_num
    center = locate(volume.array[number][None], spacing, body).centers[0]
    ours, theirs = noise_spectrum(volume.array[number], spacing, center), phantom.ctp486.power_spectrum_1d
    average = [np.average(np.linspace(0, 1, len(power)), weights=power) for power in (theirs, ours)]
    total = [np.sum(np.arange(len(power)) * power) for power in (theirs, ours)]
    print("\n| noise power spectrum | pylinac | its method repeated | difference |\n|---|---|---|---|")
    for name, (a, b) in {"average frequency (1 = corner)": average, "sum over frequencies": total}.items():
        print(f"| {name} | {a:.4g} | {b:.4g} | {100 * (b / a - 1):+.1f} % |")
    deviation = np.sqrt(np.mean((ours[2:20] / theirs[2:20] - 1) ** 2))
    print(f"\nRatio of the spectra, 2nd to 19th frequency: RMS deviation from 1 of {deviation:.3f}")
    return 0
