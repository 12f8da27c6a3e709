"""Fit the textures of the drawn phantom to a real scanner's features, through the default study (30 minutes).

Run the default study first, then `python -m benchmarks run phantom_textures results --fit textures.yaml`.

The noise is that of the study's images: each image minus the mean of the repeats. The object's texture is blurred by
the kernel and the slice profile of the scanner, as in the image model (virtual_phantom.image_model). For every region,
the features of texture plus noise are fitted to those of the dose series at 10 mGy, both reconstructions together.
Without --fit, prints for each region the correlation of the blurred texture with the mean image of the study, and the
noise variance in the region. A correlation of 1 means that the blur is that of the scan.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import yaml

from benchmarks.dose_prediction import BLUR, FITTED, UNIFORM, series
from virtual_phantom.base.streams import Branch, Stream, branch, named, root
from virtual_phantom.features.names import MEAN
from virtual_phantom.image_model.fitting import SKEWNESS_LIMIT, Measured, search
from virtual_phantom.image_model.noise import periodic_shape
from virtual_phantom.image_model.scanner import features_of
from virtual_phantom.io.volumes import read_repeats
from virtual_phantom.phantom import layout, read_masks
from virtual_phantom.phantom.layout import RoiSpec
from virtual_phantom.phantom.texture import Component, Texture

SEED = 61
PROTOCOLS = {"fbp": "group_2", "iterative": "group_1"}
LEVEL = "mgy10"
REALIZATIONS = 3  # of texture
EVALUATIONS = 160


@dataclass(frozen=True)
class Region:
    """A region of the study: its mask on a box, the axes of the box (mm; z, y, x), and noise by reconstruction."""

    name: str
    tissue: str
    roi: RoiSpec
    mask: np.ndarray
    axes: tuple[np.ndarray, np.ndarray, np.ndarray]
    spacing: tuple[float, float, float]
    mean: np.ndarray
    noise: dict[str, list[np.ndarray]]

    def blurred(self, components: tuple[Component, ...], stream: Stream) -> np.ndarray:
        """Return the texture of the object after the blur of the scanner, HU."""
        texture = Texture(components, self.tissue, stream)
        texture.condition(self.roi.shape)
        box = periodic_shape(self.mask.shape, self.spacing)
        axes = (
            axis[0] + step * (np.arange(n) - (n - len(axis)) // 2)
            for axis, n, step in zip(self.axes, box, self.spacing, strict=True)
        )
        inside = tuple(slice((n - k) // 2, (n - k) // 2 + k) for n, k in zip(box, self.mask.shape, strict=True))
        return BLUR.apply(texture.sample(*axes), self.spacing)[inside]


def read_regions(results: Path) -> tuple[dict[str, Region], dict]:
    """Return the regions of a finished study, and the phantom's layout."""
    drawn = layout.read_layout()
    rois = {roi.name: roi for roi in layout.parse_layout(drawn, root(SEED))[1]}
    tissues = {entry["name"]: entry["tissue"] for entry in drawn["rois"]}
    repeats = {}
    for name, protocol in PROTOCOLS.items():
        repeats[name], grid = read_repeats(sorted((results / "images" / protocol / LEVEL).glob("*.nii.gz")))
    (table,) = (results / "phantom").glob("voxels_1_*/rois.csv")
    found = {}
    for name, mask in read_masks(table, grid)[1].items():
        box = tuple(slice(i.min(), i.max() + 1) for i in np.nonzero(mask))
        noise = {}
        for reconstruction, images in repeats.items():
            part = images[:, *box].astype(np.float32)
            scale = np.float32(np.sqrt(len(part) / (len(part) - 1)))
            noise[reconstruction] = list((part - part.mean(axis=0)) * scale)
        axes = tuple(axis[part] for axis, part in zip(grid.axes_mm(), box, strict=True))
        mean = repeats["fbp"][:, *box].mean(axis=0)
        found[name] = Region(name, tissues[name], rois[name], mask[box], axes, grid.spacing, mean, noise)
    return found, drawn


def check(regions: dict[str, Region], drawn: dict, study_seed: int) -> None:
    """Print the correlation of the blurred texture with the mean image, and the noise variance, by region."""
    for region in regions.values():
        components = tuple(Component(**c) for c in drawn["tissues"][region.tissue].get("texture", ()))
        blurred = region.blurred(components, branch(study_seed, Branch.PHANTOM))[region.mask]
        image = region.mean[region.mask]
        noise = {name: np.mean([n[region.mask].var() for n in parts]) for name, parts in region.noise.items()}
        left = noise["fbp"] / len(region.noise["fbp"])
        print(
            f"{region.name}: correlation {np.corrcoef(blurred, image)[0, 1]:.3f}, variance {blurred.var():.0f}, "
            f"in the mean image {image.var() - left:.0f} HU2; noise "
            + ", ".join(f"{name} {value:.0f}" for name, value in noise.items())
        )


def fit(region: Region, real: dict[str, Measured], start: tuple[Component, Component]) -> list[Component]:
    """Return the fine and coarse component of a region's texture whose features are closest to the measured ones."""
    streams = [named(root(SEED), "texture", number) for number in range(REALIZATIONS)]

    def components(x: np.ndarray) -> list[Component]:
        sd, length, wide_sd, wide_length = np.exp(x[:4]).tolist()
        return [
            Component(sd, length, float(np.clip(x[4], -SKEWNESS_LIMIT, SKEWNESS_LIMIT))),
            Component(wide_sd, wide_length),
        ]

    def cost(x: np.ndarray) -> float:
        fine, coarse = components(x)
        if not (0.8 < fine.correlation_mm < 30 and 1 < coarse.correlation_mm < 40):
            return np.inf
        textures = [region.blurred((fine, coarse), stream) for stream in streams]
        misfits = []
        for name, known in real.items():
            noise = region.noise[name]
            images = [texture + noise[k % len(noise)] for k, texture in enumerate(textures)]
            images = [image + np.float32(known.mean[MEAN] - image[region.mask].mean()) for image in images]
            misfits.append(known.misfit(features_of(images, region.mask, region.spacing)))
        return float(np.mean(misfits))

    first = [start[0].sd_hu, start[0].correlation_mm, start[1].sd_hu, start[1].correlation_mm]
    x = np.append(np.log(first), start[0].skewness)
    best = search(cost, x, np.array([0.2, 0.2, 0.3, 0.3, 0.4]), EVALUATIONS)
    print(region.name, components(best), f"misfit {cost(x):.2f} -> {cost(best):.2f}", flush=True)
    return components(best)


def add_arguments(parser):
    parser.add_argument("results", type=Path, help="folder of a finished clinical study")
    parser.add_argument("--fit", type=Path, help="fit the textures and write them to this YAML file")
    parser.add_argument("--study-seed", type=int, default=2022, help="key `seed` of the study (default 2022)")


def run(options):
    regions, drawn = read_regions(options.results)
    check(regions, drawn, options.study_seed)
    if not options.fit:
        return
    real = series()
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        jobs = {}
        for name in sorted(set(regions) - {UNIFORM}, key=lambda name: -regions[name].mask.sum()):
            known = {reconstruction: real[name, reconstruction, FITTED] for reconstruction in PROTOCOLS}
            drawn_texture = tuple(Component(**c) for c in drawn["tissues"][regions[name].tissue]["texture"])
            jobs[name] = pool.submit(fit, regions[name], known, drawn_texture)
        found = {regions[name].tissue: [asdict(part) for part in job.result()] for name, job in jobs.items()}
    options.fit.write_text(yaml.safe_dump(found, sort_keys=False), encoding="utf-8")
