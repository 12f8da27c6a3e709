"""Figure of the noise calibration."""

from collections.abc import Mapping, Sequence

from virtual_phantom.figures import noise_calibration, style
from virtual_phantom.io import files
from virtual_phantom.statistics import noise
from virtual_phantom.statistics.dose_series import MEASURED_ROI
from virtual_phantom.study.job import job


def main(
    *,
    table: str,
    outputs: list[str],
    study_levels: Sequence,
    measured_noise: Sequence[Mapping],
    trial: bool,
) -> None:
    measured = [(line["label"], line["variance_hu2"]) for line in measured_noise]
    rows = files.read_csv(table)
    roi, column = noise.EVERY_ROI, noise_calibration.OVER_REPEATS
    if measured and MEASURED_ROI in set(rows["roi"]):
        roi, column = MEASURED_ROI, noise_calibration.AMONG_VOXELS
    figure = noise_calibration.draw(rows, study_levels, measured, roi, column)
    style.save(figure, outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            outputs=[snakemake.output.png, snakemake.output.pdf],
            study_levels=snakemake.params.study_levels,
            measured_noise=snakemake.params.measured,
            trial=snakemake.params.trial,
        )
