"""The highest-ranked features beside the paper's."""

from virtual_phantom import files, measured
from virtual_phantom.job import job
from virtual_phantom.statistics import ranking

with job(snakemake):
    scores = files.read_csv(snakemake.input.stability)
    files.write_csv(ranking.top(scores, measured.load_published_top()), snakemake.output[0])
