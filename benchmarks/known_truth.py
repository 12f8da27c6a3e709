"""A scanned phantom whose truth is known: how often a simulation of it lies within repeat error of real scans.

    python benchmarks/known_truth.py [--repeats 10] [--scans 3 [--own-voxels]]

The truth is the drawn phantom on voxels a third as wide as the study's. A mean of ten scans of it is the truth blurred
by a Gaussian of 0.75 voxels, and noise. What is made of it is scanned by one scanner, as the truth is. A cell is a
feature in a region; it lies within repeat error where Welch's test of as many repeats gives p of 0.05 at least, which
scans of the same do in 95 % of the cells. Prints a row for each phantom:

    the truth          scanned again, by other photons: the best there is
    own blur kept      the mean as it is: blurred twice
    own blur removed   the mean without its own blur and noise (phantom.own_blur)
    and interpolation  the same, the linear interpolation to the phantom's voxels counted as blur too
    wrong kernel       own blur removed, and images blurred by a Gaussian of 3 mm that the scanner has not

With --scans the mean is of ten reconstructions of the truth in place of a Gaussian and white noise, by a scanner whose
voxels, pixels and views are so many times as fine as the study's. With --own-voxels the study is as fine as that too:
what is compared then has the resolution at which the phantom itself was scanned, the hardest case.
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np
from scipy.ndimage import find_objects, gaussian_filter

import virtual_phantom as vp
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import block_mean
from virtual_phantom.phantom.ct import resample
from virtual_phantom.phantom.own_blur import SD_OF_FWHM, SD_OF_HALF, spectra, with_interpolation, without_own_blur
from virtual_phantom.statistics.comparison import compare
from virtual_phantom.statistics.own_edge import edge_mtf_half

SHAPE, SPACING, FINER = (24, 80, 80), (4.0, 3.75, 3.75), 3
SCANNER = {"columns": 100, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4, "projections": 150}
LEVEL, WRONG_MM, WITHIN = 6.0e-6, 3.0, 0.05
OWN_VOXELS, NOISE_HU, AVERAGED = 0.75, 17.0, 10  # 17 HU: of the printed phantom at 10 mGy


def images(phantom, repeats, seed, finer=1):
    scanner = {key: value / finer if key.endswith("_mm") else value * finer for key, value in SCANNER.items()}
    return vp.reconstruct(vp.scan(phantom, noise_level=LEVEL, repeats=repeats, seed=seed, **scanner), "fbp")


def of_image(drawn, image):
    """The drawn phantom with another image, its regions kept."""
    grid = drawn.image.grid
    fine = resample(image, grid.refined(2), outside=-1000.0)
    return replace(drawn, fine=Volume(fine, grid.refined(2)), image=Volume(block_mean(fine, 2), grid))


def of_own_scans(drawn, finer):
    """The mean of AVERAGED scans, its own blur and the spectra of itself and its noise, as the workflow has them."""
    scans = np.stack([one.array for one in images(drawn, AVERAGED, 3, finer)]).astype(np.float64)
    noise = np.tensordot(np.resize([1, -1], AVERAGED), scans, 1) / AVERAGED
    inside = np.any([roi.mask for roi in drawn.rois], axis=0)
    print(f"noise of one scan {np.sqrt(scans[:, inside].var(axis=0, ddof=1).mean()):.1f} HU", flush=True)
    mean = Volume(scans.mean(axis=0).astype(np.float32), drawn.image.grid)
    (box,) = find_objects(inside.astype(np.uint8))
    in_plane = SD_OF_HALF / edge_mtf_half(mean)
    own = (SD_OF_FWHM * mean.grid.spacing[0], in_plane, in_plane)
    return mean, own, spectra(mean.array[box], noise[box], mean.grid.spacing)


def main(repeats, scans, own_voxels):
    warnings.simplefilter("ignore")  # small regions: it is the comparison that is looked at
    drawn, truth, mean, own, measured = scanned(scans, own_voxels) if scans else modelled()
    finer = scans if own_voxels else 1
    spacing = mean.grid.spacing
    print(f"own blur in the plane: SD {own[1]:.2f} mm, along z {own[0]:.2f} mm; {repeats} repeats", flush=True)
    phantoms = {
        "the truth": truth,
        "own blur kept": of_image(drawn, mean),
        "own blur removed": of_image(drawn, without_own_blur(mean, own, measured)),
        "and interpolation": of_image(drawn, without_own_blur(mean, with_interpolation(own, spacing), measured)),
    }
    reference = vp.extract(images(truth, repeats, 1, finer), drawn)
    print("phantom             within repeat error   median |shift| (repeat SDs)")
    for name, phantom in phantoms.items():
        series = images(phantom, repeats, 2, finer)
        show(name, series, drawn, reference)
        if name == "own blur removed":
            sigma = [WRONG_MM / step for step in drawn.image.grid.spacing]
            wrong = [Volume(gaussian_filter(one.array.astype(np.float32), sigma), one.grid) for one in series]
    show("wrong kernel", wrong, drawn, reference)


def show(name, series, drawn, reference):
    cells = compare(vp.extract(series, drawn), reference, list(FEATURES))
    share = float((cells["p_mean"] >= WITHIN).mean())
    print(f"{name:20}{100 * share:15.1f} %     {cells['shift_sd'].abs().median():.2f}", flush=True)


def modelled():
    """The drawn phantom on the study's voxels, on finer ones, and a mean that is these blurred by a Gaussian."""
    drawn = vp.draw_phantom(SHAPE, SPACING)
    fine = vp.draw_phantom(
        tuple(FINER * size for size in SHAPE), tuple(step / FINER for step in SPACING), oversampling=1
    ).image
    rng = np.random.default_rng(2022)
    noise = rng.normal(0, NOISE_HU / AVERAGED**0.5, (2, *fine.grid.shape))
    mean = Volume((gaussian_filter(fine.array, OWN_VOXELS) + noise[0]).astype(np.float32), fine.grid)
    inside = np.any([roi.mask for roi in drawn.rois], axis=0)
    box = tuple(slice(FINER * index.min(), FINER * (index.max() + 1)) for index in np.nonzero(inside))
    in_plane = SD_OF_HALF / edge_mtf_half(mean)
    own = (OWN_VOXELS * fine.grid.spacing[0], in_plane, in_plane)
    return drawn, of_image(drawn, fine), mean, own, spectra(mean.array[box], noise[1][box], fine.grid.spacing)


def scanned(finer, own_voxels):
    """The same, but that the mean is of scans, and how it was scanned is found from it."""
    fine = vp.draw_phantom(tuple(finer * size for size in SHAPE), tuple(step / finer for step in SPACING))
    mean, own, measured = of_own_scans(fine, finer)
    if own_voxels:
        return fine, fine, mean, own, measured
    drawn = vp.draw_phantom(SHAPE, SPACING)
    truth = replace(drawn, fine=fine.fine, image=Volume(block_mean(fine.fine.array, 2 * finer), drawn.image.grid))
    return drawn, truth, mean, own, measured


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--scans", type=int, metavar="FINER", help="2 or 3; absent: a Gaussian and white noise")
    parser.add_argument("--own-voxels", action="store_true", help="with --scans")
    asked = parser.parse_args()
    main(asked.repeats, asked.scans, asked.own_voxels)
