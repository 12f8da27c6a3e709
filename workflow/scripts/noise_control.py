"""Features of the phantom with white noise of the variance of each protocol, without a scan."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.base import streams
from virtual_phantom.features import extraction
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files, volumes
from virtual_phantom.phantom import white_noise
from virtual_phantom.statistics.noise import repeat_variance
from virtual_phantom.study.job import job, log


def main(
    *,
    images: Mapping[str, Sequence[str]],
    phantom_file: str,
    roi_file: str,
    output: str,
    groups: Mapping[str, int],
    seeds: int,
    study_seed: int,
    extraction_settings: Mapping,
) -> None:
    clean = volumes.read_nifti(phantom_file)
    rois, masks = phantom.read_masks(roi_file, clean.grid)
    classes = dict(zip(rois["roi"], rois["tissue_class"], strict=True))
    parameters = read_parameters(**extraction_settings)
    root = streams.branch(study_seed, streams.Branch.NOISE_CONTROL)
    tables = []
    for protocol, group in groups.items():
        scans = (volumes.read_nifti(path).array for path in images[protocol])
        variance = repeat_variance(scans, masks, name=f"noise control, {protocol}").set_index("roi")["variance_hu2"]
        log.info("%s: variance %s", protocol, ", ".join(f"{roi} {variance[roi]:.4g}" for roi in variance.index))
        for repeat in range(seeds):
            noisy = white_noise.add_white_noise(clean, masks, variance, streams.named(root, protocol, repeat))
            found = extraction.extract(noisy, masks, name=f"noise control, {protocol}", parameters=parameters)
            found.insert(0, "tissue_class", found["roi"].map(classes))
            tables.append(found.assign(protocol=protocol, group=group, seed=repeat))
    files.write_csv(pd.concat(tables, ignore_index=True), output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            images=snakemake.params.images,
            phantom_file=snakemake.input.phantom,
            roi_file=snakemake.input.rois,
            output=snakemake.output[0],
            groups=snakemake.params.groups,
            seeds=snakemake.params.seeds,
            study_seed=snakemake.params.study_seed,
            extraction_settings=snakemake.params.parameters,
        )
