"""Figure of the noise calibration."""

from virtual_phantom.figures import noise_calibration, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    params = snakemake.params
    measured = [(line["label"], line["variance_hu2"]) for line in params.measured]
    figure = noise_calibration.draw(files.read_csv(snakemake.input.table), params.study_levels, measured)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf], trial=snakemake.params.trial)
