"""Write the table trust.csv: stability of each feature with its interval, the compared groups, and a sentence."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import trust
from virtual_phantom.statistics.stability_measures import UNVARYING
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    output: str,
    groups: Mapping[str, int],
    noise: Mapping[str, str],
    seeds: int,
    statistics: Mapping,
    cut_offs: Mapping[str, float],
    sharing: Mapping[str, str],
) -> None:
    table = read_groups(features_file, groups, noise=noise, seeds=seeds)
    labels = {groups[protocol]: label for protocol, label in sharing.items()}
    found = trust.trust_table(
        table,
        features_of(table),
        labels,
        cut_offs["w_stability_percent"],
        threshold=statistics["threshold"],
        compare=statistics["compare"],
        source=features_file,
    )
    files.write_csv(found, output)
    counts = found["stable"].value_counts()
    log.info(
        "%d features: %d stable, %d not stable, %d undecided, %d without variation; stability by chance %.1f %%",
        len(found),
        *(counts.get(verdict, 0) for verdict in ("yes", "no", "undecided", UNVARYING)),
        found["if_equal_percent"].iloc[0],
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
            cut_offs=snakemake.params.cut_offs,
            sharing=snakemake.params.sharing,
        )
