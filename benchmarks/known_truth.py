"""A scanned phantom whose truth is known: how often a simulation of it lies within repeat error of real scans.

    python benchmarks/known_truth.py [--repeats 10]

The truth is the drawn phantom on voxels a third as wide as the study's. A mean of ten scans of it is the truth blurred
by a Gaussian of 0.75 voxels, and noise. What is made of it is scanned by one scanner, as the truth is. A cell is a
feature in a region; it lies within repeat error where Welch's test of as many repeats gives p of 0.05 at least, which
scans of the same do in 95 % of the cells. Prints a row for each phantom:

    the truth          scanned again, by other photons: the best there is
    own blur kept      the mean as it is: blurred twice
    own blur removed   the mean without its own blur and noise (phantom.own_blur)
    and interpolation  the same, the linear interpolation to the phantom's voxels counted as blur too
    wrong kernel       own blur removed, and images blurred by a Gaussian of 3 mm that the scanner has not
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

import virtual_phantom as vp
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import block_mean
from virtual_phantom.phantom.ct import resample
from virtual_phantom.phantom.own_blur import SD_OF_HALF, spectra, with_interpolation, without_own_blur
from virtual_phantom.statistics.comparison import compare
from virtual_phantom.statistics.own_edge import edge_mtf_half

SHAPE, SPACING, FINER = (24, 80, 80), (4.0, 3.75, 3.75), 3
SCANNER = {"columns": 100, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4, "projections": 150}
LEVEL, WRONG_MM, WITHIN = 6.0e-6, 3.0, 0.05
OWN_VOXELS, NOISE_HU, AVERAGED = 0.75, 17.0, 10  # 17 HU: of the printed phantom at 10 mGy


def images(phantom, repeats, seed):
    return vp.reconstruct(vp.scan(phantom, noise_level=LEVEL, repeats=repeats, seed=seed, **SCANNER), "fbp")


def of_image(drawn, image):
    """The drawn phantom with another image, its regions kept."""
    grid = drawn.image.grid
    fine = resample(image, grid.refined(2), outside=-1000.0)
    return replace(drawn, fine=Volume(fine, grid.refined(2)), image=Volume(block_mean(fine, 2), grid))


def main(repeats):
    warnings.simplefilter("ignore")  # small regions: it is the comparison that is looked at
    drawn = vp.draw_phantom(SHAPE, SPACING)
    truth = vp.draw_phantom(
        tuple(FINER * size for size in SHAPE), tuple(step / FINER for step in SPACING), oversampling=1
    ).image
    spacing = truth.grid.spacing
    rng = np.random.default_rng(2022)
    noise = rng.normal(0, NOISE_HU / AVERAGED**0.5, (2, *truth.grid.shape))
    mean = Volume((gaussian_filter(truth.array, OWN_VOXELS) + noise[0]).astype(np.float32), truth.grid)
    inside = np.any([roi.mask for roi in drawn.rois], axis=0)
    box = tuple(slice(FINER * index.min(), FINER * (index.max() + 1)) for index in np.nonzero(inside))
    measured = spectra(mean.array[box], noise[1][box], spacing)
    in_plane = SD_OF_HALF / edge_mtf_half(mean)
    print(f"own blur in the plane: SD {in_plane:.2f} mm, put in {OWN_VOXELS * spacing[1]:.2f} mm; {repeats} repeats")
    own = (OWN_VOXELS * spacing[0], in_plane, in_plane)
    phantoms = {
        "the truth": truth,
        "own blur kept": mean,
        "own blur removed": without_own_blur(mean, own, measured),
        "and interpolation": without_own_blur(mean, with_interpolation(own, spacing), measured),
    }
    found = {name: images(of_image(drawn, image), repeats, seed=2) for name, image in phantoms.items()}
    sigma = [WRONG_MM / step for step in SPACING]
    found["wrong kernel"] = [
        Volume(gaussian_filter(one.array.astype(np.float32), sigma), one.grid) for one in found["own blur removed"]
    ]
    reference = vp.extract(images(of_image(drawn, truth), repeats, seed=1), drawn)
    print("phantom             within repeat error   median |shift| (repeat SDs)")
    for name, series in found.items():
        cells = compare(vp.extract(series, drawn), reference, list(FEATURES))
        share = float((cells["p_mean"] >= WITHIN).mean())
        print(f"{name:20}{100 * share:15.1f} %     {cells['shift_sd'].abs().median():.2f}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    main(parser.parse_args().repeats)
