"""The highest-ranked features, beside the paper's where the phantom is that one."""

from virtual_phantom.io import files
from virtual_phantom.statistics import measured, ranking
from virtual_phantom.study.job import job

with job(snakemake):
    params = snakemake.params
    scores = files.read_csv(snakemake.input.stability)
    draws = measured.load_score_draws(params.seeds) if params.with_measured else None
    # Of the printed phantom: beside another they would pass for a comparison.
    published = measured.load_published_top() if params.with_measured else None
    files.write_csv(ranking.top_features(scores, published, draws), snakemake.output[0])
