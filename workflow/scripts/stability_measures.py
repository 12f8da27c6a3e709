"""Compute the stability of every feature by W, ICC, CCC, CV and QCD, and the features that are stable by each."""

from collections.abc import Mapping

from virtual_phantom.features.names import features_of
from virtual_phantom.features.tables import read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import robustness, stability_measures
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    trust_file: str,
    measures_output: str,
    features_output: str,
    images: Mapping,
    cut_offs: Mapping[str, float],
) -> None:
    table = read_groups(features_file, **images)
    scores = robustness.between_protocols(files.read_csv(trust_file))
    measured = stability_measures.measure_table(table, scores, features_of(table), cut_offs, features_file)
    features = stability_measures.stable_by_feature(measured)
    files.write_csv(measured, measures_output)
    files.write_csv(features, features_output)
    for measure, rows in measured.groupby("measure", sort=False):
        counts = rows["stable"].value_counts()
        log.info(
            "%s, cut-off %g: %d of %d features stable, %d undefined",
            measure,
            rows["cut_off"].iloc[0],
            counts.get("yes", 0),
            len(rows),
            counts.get("undefined", 0),
        )
    log.info("stable by all measures: %d", (features["stable_by"] == len(stability_measures.CUT_OFFS)).sum())


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            trust_file=snakemake.input.trust,
            measures_output=snakemake.output.measures,
            features_output=snakemake.output.features,
            images=snakemake.params.images,
            cut_offs=snakemake.params.cut_offs,
        )
