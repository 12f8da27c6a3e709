"""The noise level at which a protocol shows the variance that ROIs have in a recording."""

from dataclasses import asdict

from virtual_phantom.base.errors import InputError
from virtual_phantom.features.names import VARIANCE
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import where
from virtual_phantom.statistics import noise
from virtual_phantom.study import matched_noise
from virtual_phantom.study.job import job

with job(snakemake) as log:
    meets = snakemake.params.meets
    source = f"recording {meets['recording']}"
    recorded = where(files.read_csv(snakemake.input.recorded), meets["where"], source)
    if VARIANCE not in recorded:
        raise InputError(
            f"{source}: has no {VARIANCE}, which a noise level is matched by; extract it, or give the level an A"
        )
    measured = recorded.pivot(index="image", columns="roi", values=VARIANCE)
    found = noise.match(files.read_csv(snakemake.input.calibration), meets["protocol"], meets["rois"], measured)
    matched_noise.write_level({**asdict(found), **meets}, snakemake.output[0])
    log.info("%s: %s", snakemake.wildcards.noise, found)
    if found.extrapolated:
        log.warning("A lies outside the levels of the noise calibration; add a level beyond it")
