"""Figure of the noise calibration."""

from collections.abc import Mapping, Sequence

from virtual_phantom.figures import noise_calibration, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job


def main(
    *,
    table: str,
    png: str,
    pdf: str,
    study_levels: Sequence,
    measured_noise: Sequence[Mapping],
    trial: bool,
) -> None:
    measured = [(line["label"], line["variance_hu2"]) for line in measured_noise]
    figure = noise_calibration.draw(files.read_csv(table), study_levels, measured)
    style.save(figure, [png, pdf], trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table=snakemake.input.table,
            png=snakemake.output.png,
            pdf=snakemake.output.pdf,
            study_levels=snakemake.params.study_levels,
            measured_noise=snakemake.params.measured,
            trial=snakemake.params.trial,
        )
