"""List the highest-ranked features, and for the printed phantom also the measured and published rankings."""

from virtual_phantom.io import files
from virtual_phantom.statistics import measured, ranking
from virtual_phantom.study.job import job


def main(*, stability: str, output: str, seeds: int, with_measured: bool) -> None:
    scores = files.read_csv(stability)
    draws = measured.load_score_draws(seeds) if with_measured else None
    # Published values of the printed phantom are only comparable with a simulation of this phantom.
    published = measured.load_published_top() if with_measured else None
    files.write_csv(ranking.top_features(scores, published, draws), output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            stability=snakemake.input.stability,
            output=snakemake.output[0],
            seeds=snakemake.params.seeds,
            with_measured=snakemake.params.with_measured,
        )
