"""Figure of each feature's stability with the study's physics against that without."""

from virtual_phantom.figures import physics_change, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    params = snakemake.params
    figure = physics_change.draw(files.read_csv(snakemake.input.table), params.threshold, noise=params.noise)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf], trial=params.trial)
