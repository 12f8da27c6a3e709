"""Figure of one principal component analysis."""

from virtual_phantom.figures import pca, style
from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake):
    figure = pca.draw(files.read_csv(snakemake.input.table), snakemake.params.title)
    style.save(figure, [snakemake.output.png, snakemake.output.pdf], trial=snakemake.params.trial)
