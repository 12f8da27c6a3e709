"""Write the table trust.csv (robustness of each feature against each change) and a parameter file of pyradiomics."""

from collections.abc import Mapping, Sequence

from virtual_phantom.features.names import features_of
from virtual_phantom.features.selected import selected_parameters
from virtual_phantom.features.settings import read_extraction
from virtual_phantom.features.tables import read_features, read_groups
from virtual_phantom.io import files
from virtual_phantom.statistics import EXTRACTION, extraction_settings, robustness, trust
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    extraction_file: str | None,
    table_output: str,
    features_output: str,
    images: Mapping,
    statistics: Mapping,
    cut_offs: Mapping[str, float],
    sharing: Mapping[int, str],
    pairs: Sequence[Mapping],
    parameters: Mapping,
) -> None:
    every_image = read_features(features_file)
    threshold = statistics["threshold"]
    acquired = [pair for pair in pairs if pair["kind"] != EXTRACTION]
    found = robustness.robustness_table(
        every_image, features_of(every_image), acquired, cut_offs, threshold=threshold, source=features_file
    )
    if len(images["groups"]) > 1:
        table = read_groups(features_file, **images)
        stability = trust.trust_table(
            table,
            features_of(table),
            sharing,
            cut_offs["w_stability_percent"],
            threshold=threshold,
            compare=statistics["compare"],
            source=features_file,
        )
        found = robustness.with_protocols(found, stability)
    if extraction_file:
        settings = extraction_settings.wide_table(files.read_csv(extraction_file))
        extracted = [pair for pair in pairs if pair["kind"] == EXTRACTION]
        found = robustness.with_extraction(
            found, settings, extracted, cut_offs, threshold=threshold, source=extraction_file
        )
    files.write_csv(found, table_output)
    uses = found.drop_duplicates("feature")
    robust = list(uses.loc[uses["use"] == robustness.ROBUST, "feature"])
    text = selected_parameters(robust, read_extraction(parameters["path"]), parameters)
    files.write_text(text, features_output)
    log.info(
        "%d features, %d kinds of change: %s",
        len(uses),
        found["change"].nunique(),
        ", ".join(f"{count} {use}" for use, count in uses["use"].value_counts().items()),
    )


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            extraction_file=snakemake.input.get("extraction") or None,
            table_output=snakemake.output.table,
            features_output=snakemake.output.features,
            images=snakemake.params.images,
            statistics=snakemake.params.statistics,
            cut_offs=snakemake.params.cut_offs,
            sharing=snakemake.params.sharing,
            pairs=snakemake.params.pairs,
            parameters=snakemake.params.parameters,
        )
