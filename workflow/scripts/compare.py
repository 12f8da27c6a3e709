"""Compare the features of one protocol and noise level with the features of a recording."""

from collections.abc import Mapping

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.settings import Comparison
from virtual_phantom.features import tables
from virtual_phantom.features.settings import other_settings, read_extraction
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.statistics import comparability, comparison, comparison_summary
from virtual_phantom.study.job import job, log


def main(
    *,
    simulated_features: str,
    recorded_features: str,
    cells_file: str,
    features_file: str,
    families_file: str,
    settings: Comparison,
    seeds: int,
    extraction: Mapping,
    dimensions: int | None,
) -> None:
    simulated = tables.read_features(simulated_features)
    simulated = tables.select(simulated, protocols=[settings.protocol], noise=[settings.noise], seeds=seeds)
    source = f"recording {settings.recording}"
    recorded = select_rows(files.read_csv(recorded_features), settings.where, source)
    features = comparison.common_features(simulated, recorded)
    cells = comparison.compare(simulated, recorded, features, rois=settings.rois, margin_sd=settings.margin_sd)
    files.write_csv(cells, cells_file)
    own = read_extraction(extraction["path"])
    other = other_settings(features, recorded, own, source, extraction["section"], dimensions)
    for line in dict.fromkeys(other.values()):
        log.warning("%s: features were extracted with other settings: %s", source, line)
    sizes = comparability.other_sizes(simulated, recorded, features, list(cells["roi"].unique()))
    for line in dict.fromkeys(sizes.values()):
        log.warning("%s: %d features grow with the ROI, which has %s", source, len(sizes), line)
    summary = comparison_summary.summary(cells).assign(
        other_settings=[other.get(feature, "") for feature in features],
        other_sizes=[sizes.get(feature, "") for feature in features],
    )
    files.write_csv(summary, features_file)
    families = comparison_summary.family_summary(cells)
    files.write_csv(families, families_file)
    log.info("\n%s", families.to_string(index=False))


if "snakemake" in globals():
    with job(snakemake):
        main(
            simulated_features=snakemake.input.features,
            recorded_features=snakemake.input.recorded,
            cells_file=snakemake.output.cells,
            features_file=snakemake.output.features,
            families_file=snakemake.output.families,
            settings=from_mapping(Comparison, snakemake.params.settings),
            seeds=snakemake.params.seeds,
            extraction=snakemake.params.parameters,
            dimensions=snakemake.params.dimensions,
        )
