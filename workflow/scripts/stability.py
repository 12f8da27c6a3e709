"""Compute stability and discriminative power of every feature over the groups of protocols."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import wilcoxon
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    output: str,
    groups: Mapping[str, int],
    noise: str,
    seeds: int,
    statistics: Mapping,
) -> None:
    table = read_groups(features_file, groups, noise=noise, seeds=seeds)
    scores = wilcoxon.scores(table, features_of(table), source=features_file, **statistics)
    files.write_csv(scores, output)
    log.info(
        "mean stability %.1f %%, mean discriminative power %.1f %%",
        scores["stability_percent"].mean(),
        scores["discrimination_percent"].mean(),
    )


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            output=snakemake.output[0],
            groups=snakemake.params.groups,
            noise=snakemake.params.noise,
            seeds=snakemake.params.seeds,
            statistics=snakemake.params.statistics,
        )
