"""Features of one protocol and noise level against those of a recording."""

from virtual_phantom.features import settings, tables
from virtual_phantom.io import files
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.statistics import comparability, comparison, comparison_summary
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    simulated = tables.read(snakemake.input.features)
    simulated = tables.select(simulated, protocols=[params.protocol], noise=[params.noise], seeds=params.seeds)
    source = f"recording {params.recording}"
    recorded = select_rows(files.read_csv(snakemake.input.recorded), params.where, source)
    features = comparison.common_features(simulated, recorded)
    cells = comparison.compare(simulated, recorded, features, rois=params.rois, margin_sd=params.margin_sd)
    files.write_csv(cells, snakemake.output.cells)
    other = settings.other_settings(features, recorded, settings.of_parameters(params.parameters["path"]), source)
    for line in dict.fromkeys(other.values()):
        log.warning("%s: features were extracted with other settings: %s", source, line)
    sizes = comparability.other_sizes(simulated, recorded, features, list(cells["roi"].unique()))
    for line in dict.fromkeys(sizes.values()):
        log.warning("%s: %d features grow with the ROI, which has %s", source, len(sizes), line)
    summary = comparison_summary.summary(cells).assign(
        other_settings=[other.get(feature, "") for feature in features],
        other_sizes=[sizes.get(feature, "") for feature in features],
    )
    files.write_csv(summary, snakemake.output.features)
    families = comparison_summary.family_summary(cells)
    files.write_csv(families, snakemake.output.families)
    log.info("\n%s", families.to_string(index=False))
