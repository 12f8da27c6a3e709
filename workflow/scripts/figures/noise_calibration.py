"""Figure of the noise calibration."""

from virtual_phantom.figures import noise_calibration, style, tables
from virtual_phantom.job import job

with job(snakemake):
    params = snakemake.params
    measured = [(line["label"], line["variance_hu2"]) for line in params.measured]
    figure = noise_calibration.draw(tables.read_table(snakemake.input.table), params.study_levels, measured)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf])
