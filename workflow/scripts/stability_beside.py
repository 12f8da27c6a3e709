"""Join the scores of every feature over the groups of the study and over the conditions of a recording."""

from virtual_phantom.io import files
from virtual_phantom.statistics import ranking
from virtual_phantom.study.job import job, log


def main(*, stability: str, scores: str, output: str) -> None:
    simulated, recorded = (files.read_csv(path) for path in (stability, scores))
    table = ranking.compare_scores(simulated, recorded)
    files.write_csv(table, output)
    correlation = table[["stability_percent_simulated", "stability_percent_measured"]].corr("spearman").iloc[0, 1]
    log.info("stability of %d features: Spearman %.2f between simulated and measured", len(table), correlation)


if "snakemake" in globals():
    with job(snakemake):
        main(
            stability=snakemake.input.stability,
            scores=snakemake.input.scores,
            output=snakemake.output[0],
        )
