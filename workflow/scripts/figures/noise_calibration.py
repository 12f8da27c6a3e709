"""Figure of the noise calibration."""

from virtual_phantom.figures import noise_calibration, style, tables
from virtual_phantom.job import job

with job(snakemake):  # noqa: F821
    params = snakemake.params  # noqa: F821
    measured = [(line["label"], line["variance_hu2"]) for line in params.measured]
    figure = noise_calibration.draw(tables.read_table(snakemake.input.table), params.study_levels, measured)  # noqa: F821
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])  # noqa: F821
