"""Find the noise level at which a protocol has the variance in ROIs that a recording has."""

from dataclasses import asdict

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.settings import from_mapping, to_mapping
from virtual_phantom.config.settings import NoiseTarget
from virtual_phantom.features.names import VARIANCE
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.statistics import noise
from virtual_phantom.study import matched_noise
from virtual_phantom.study.job import job, log


def main(
    *,
    recorded_features: str,
    calibration: str,
    output: str,
    noise_name: str,
    target: NoiseTarget,
) -> None:
    source = f"recording {target.recording}"
    recorded = select_rows(files.read_csv(recorded_features), target.where, source)
    if VARIANCE not in recorded:
        raise InputError(
            f"{source}: has no {VARIANCE}, which a noise level is matched by; extract it, or give the level an A"
        )
    measured = recorded.pivot(index="image", columns="roi", values=VARIANCE)
    found = noise.match_noise_level(files.read_csv(calibration), target.protocol, target.rois, measured)
    matched_noise.write_level({**asdict(found), **to_mapping(target)}, output)
    log.info("%s: %s", noise_name, found)
    if found.extrapolated:
        log.warning("A lies outside the levels of the noise calibration; add a level beyond it")


if "snakemake" in globals():
    with job(snakemake):
        main(
            recorded_features=snakemake.input.recorded,
            calibration=snakemake.input.calibration,
            output=snakemake.output[0],
            noise_name=snakemake.wildcards.noise,
            target=from_mapping(NoiseTarget, snakemake.params.meets),
        )
