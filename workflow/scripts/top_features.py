"""List the highest-ranked features, and for the printed phantom also the measured and published rankings."""

from virtual_phantom.io import files
from virtual_phantom.statistics import measured, ranking
from virtual_phantom.study.job import job


def main(*, stability: str, output: str, seeds: int, measured_acquisitions: str | None) -> None:
    scores = ranking.assessed(files.read_csv(stability), stability)
    draws = measured.load_score_draws(seeds, measured_acquisitions) if measured_acquisitions else None
    # Published values of the printed phantom are only comparable with a simulation of this phantom.
    published = measured.load_published_top() if measured_acquisitions else None
    files.write_csv(ranking.top_features(scores, published, draws), output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            stability=snakemake.input.stability,
            output=snakemake.output[0],
            seeds=snakemake.params.seeds,
            measured_acquisitions=snakemake.params.measured_acquisitions,
        )
