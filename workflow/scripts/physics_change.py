"""Compare the stability of every feature with and without the physics of the study."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import physics_change, robustness, trust
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    trust_file: str,
    output: str,
    images: Mapping,
    statistics: Mapping,
    cut_offs: Mapping[str, float],
    sharing: Mapping[int, str],
) -> None:
    table = read_groups(features_file, **images)
    without = trust.trust_table(
        table,
        features_of(table),
        sharing,
        cut_offs["w_stability_percent"],
        threshold=statistics["threshold"],
        compare=statistics["compare"],
        source=features_file,
    )
    found = physics_change.stability_change(robustness.between_protocols(files.read_csv(trust_file)), without)
    files.write_csv(found, output)
    log.info("%d of %d features change", (found["changed"] == "yes").sum(), len(found))


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            trust_file=snakemake.input.trust,
            output=snakemake.output[0],
            images=snakemake.params.images,
            statistics=snakemake.params.statistics,
            cut_offs=snakemake.params.cut_offs,
            sharing=snakemake.params.sharing,
        )
