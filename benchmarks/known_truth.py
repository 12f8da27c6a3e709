"""Count features of a phantom made from scans that agree with the known true phantom within repeat error (minutes).

The truth is the drawn phantom on voxels a third as wide as the study's. The mean of ten scans is the truth with a
Gaussian blur of 0.75 voxels and noise. A feature in a region agrees if Welch's test gives p >= 0.05. Prints a row per
phantom::

    the truth          scanned again with other noise: the upper limit
    own blur kept      the mean image, which is blurred twice
    own blur removed   the mean image after deconvolution (phantom.deconvolution)
    and voxels         as before, and the blur of the phantom's voxels removed, as in the workflow
    wrong kernel       own blur removed, and images blurred by a Gaussian of 3 mm

With --scans, the mean image comes from ten simulated scans whose voxels, pixels and views are FINER times as fine as
the study's. With --own-voxels, the study is as fine as these scans, which is the hardest case.
"""

import warnings
from dataclasses import replace

import numpy as np
from scipy.ndimage import find_objects, gaussian_filter

import virtual_phantom as vp
from virtual_phantom.features.names import FEATURES
from virtual_phantom.io.volumes import Volume
from virtual_phantom.phantom import block_mean
from virtual_phantom.phantom.ct import resample
from virtual_phantom.phantom.deconvolution import SD_OF_FWHM, SD_OF_HALF, add_voxel_blur, deconvolve, measure_spectra
from virtual_phantom.statistics.comparison import compare
from virtual_phantom.statistics.surface_resolution import edge_mtf_half

SHAPE, SPACING, FINER = (24, 80, 80), (4.0, 3.75, 3.75), 3
SCANNER = {"columns": 100, "rows": 30, "column_pitch_mm": 6.4, "row_pitch_mm": 6.4, "projections": 150}
LEVEL, WRONG_MM, WITHIN = 6.0e-6, 3.0, 0.05
OWN_VOXELS, NOISE_HU, AVERAGED = 0.75, 17.0, 10  # 17 HU: printed phantom at 10 mGy


def images(phantom, repeats, seed, finer=1):
    scanner = {key: value / finer if key.endswith("_mm") else value * finer for key, value in SCANNER.items()}
    return vp.reconstruct(vp.scan(phantom, noise_level=LEVEL, repeats=repeats, seed=seed, **scanner), "fbp")


def of_image(drawn, image, oversampling=2):
    """Drawn phantom with another image."""
    grid = drawn.image.grid
    fine = Volume(resample(image, grid.refined(oversampling), outside=-1000.0), grid.refined(oversampling))
    return replace(drawn, fine=fine, image=Volume(block_mean(fine.array, oversampling), grid))


def of_own_scans(drawn, finer, seed):
    """Mean of AVERAGED scans, its blur, and its spectrum and noise spectrum."""
    scans = np.stack([image.array for image in images(drawn, AVERAGED, seed, finer)]).astype(np.float64)
    noise = np.tensordot(np.resize([1, -1], AVERAGED), scans, 1) / AVERAGED
    inside = np.any([roi.mask for roi in drawn.rois], axis=0)
    print(f"noise of one scan {np.sqrt(scans[:, inside].var(axis=0, ddof=1).mean()):.1f} HU", flush=True)
    mean = Volume(scans.mean(axis=0).astype(np.float32), drawn.image.grid)
    return mean, *blur_and_spectra(drawn, mean, noise, SD_OF_FWHM)


def blur_and_spectra(drawn, mean, noise, sd_voxels):
    """Blur of a mean image (z, y, x; along z in voxels), and its spectrum and noise spectrum."""
    (box,) = find_objects(np.any([roi.mask for roi in drawn.rois], axis=0).astype(np.uint8))
    in_plane = SD_OF_HALF / edge_mtf_half(mean)
    own_blur = (sd_voxels * mean.grid.spacing[0], in_plane, in_plane)
    return own_blur, measure_spectra(mean.array[box], noise[box], mean.grid.spacing)


def run(options):
    repeats, scans, own_voxels, seed = options.repeats, options.scans, options.own_voxels, options.seed
    warnings.simplefilter("ignore")  # about small regions
    drawn, truth, mean, own_blur, measured = scanned(scans, own_voxels, seed) if scans else modeled()
    finer = scans if own_voxels else 1
    spacing, fine = mean.grid.spacing, drawn.image.grid.refined(options.oversampling).spacing
    aligned = np.allclose(spacing, fine)
    print(
        f"own blur in the plane: SD {own_blur[1]:.2f} mm, along z {own_blur[0]:.2f} mm; {repeats} repeats", flush=True
    )
    phantoms = {"the truth": truth} | {
        name: of_image(drawn, image, options.oversampling)
        for name, image in (
            ("own blur kept", mean),
            ("own blur removed", deconvolve(mean, own_blur, measured)),
            ("and voxels", deconvolve(mean, add_voxel_blur(own_blur, spacing, fine, aligned), measured)),
        )
    }
    reference = vp.extract(images(truth, repeats, seed, finer), drawn)
    print("phantom             within repeat error   median |shift| (repeat SDs)")
    for name, phantom in phantoms.items():
        series = images(phantom, repeats, seed + 1, finer)
        show(name, series, drawn, reference)
        if name == "own blur removed":
            sigma = [WRONG_MM / step for step in drawn.image.grid.spacing]
            wrong = [Volume(gaussian_filter(one.array.astype(np.float32), sigma), one.grid) for one in series]
    show("wrong kernel", wrong, drawn, reference)


def show(name, series, drawn, reference):
    cells = compare(vp.extract(series, drawn), reference, list(FEATURES))
    share = float((cells["p_mean"] >= WITHIN).mean())
    print(f"{name:20}{100 * share:15.1f} %     {cells['shift_sd'].abs().median():.2f}", flush=True)


def modeled():
    """Drawn phantom, truth, and the mean image from a Gaussian blur and white noise."""
    fine, drawn, truth = drawn_finer(FINER)
    rng = np.random.default_rng(2022)
    noise = rng.normal(0, NOISE_HU / AVERAGED**0.5, (2, *fine.image.grid.shape))
    mean = Volume((gaussian_filter(fine.image.array, OWN_VOXELS) + noise[0]).astype(np.float32), fine.image.grid)
    return drawn, truth, mean, *blur_and_spectra(fine, mean, noise[1], OWN_VOXELS)


def scanned(finer, own_voxels, seed):
    """As modeled, with a mean image of simulated scans, whose blur is measured."""
    fine, drawn, truth = drawn_finer(finer)
    mean, own_blur, measured = of_own_scans(fine, finer, seed + 2)
    return (fine, fine, mean, own_blur, measured) if own_voxels else (drawn, truth, mean, own_blur, measured)


def drawn_finer(finer):
    """Phantom on fine voxels, on the study's voxels, and fine phantom averaged to the study's voxels."""
    fine = vp.draw_phantom(tuple(finer * size for size in SHAPE), tuple(step / finer for step in SPACING))
    drawn = vp.draw_phantom(SHAPE, SPACING)
    seen = Volume(block_mean(fine.fine.array, 2 * finer), drawn.image.grid)
    return fine, drawn, replace(drawn, fine=fine.fine, image=seen)


def add_arguments(parser):
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--scans", type=int, metavar="FINER", help="2 or 3 (default: a Gaussian blur and white noise)")
    parser.add_argument("--own-voxels", action="store_true", help="with --scans")
    parser.add_argument(
        "--oversampling", type=int, default=2, help="oversampling of the phantom made from the mean image"
    )
    parser.add_argument("--seed", type=int, default=1)
