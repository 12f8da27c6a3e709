"""Find the image property that best explains why simulated and recorded features differ.

The script writes diagnosis.json, physics.yaml, maps and the report.
"""

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.settings import Comparison
from virtual_phantom.diagnosis.features.responses import compared, responses
from virtual_phantom.diagnosis.features.verdict import diagnose_features, overlay
from virtual_phantom.diagnosis.result_files import DiagnosisFiles, write_diagnosis
from virtual_phantom.diagnosis.verdict_text import console_text
from virtual_phantom.features.settings import read_extraction
from virtual_phantom.io.files import read_csv
from virtual_phantom.io.volumes import read_nifti
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.report.diagnosis_of_features import feature_diagnosis_page
from virtual_phantom.study.job import job, log


def main(
    *,
    changed_features_file: str,
    recorded_features_file: str,
    image_file: str,
    output: DiagnosisFiles,
    name: str,
    settings: Comparison,
    dimensions: int,
    stored_offset_hu: float,
    parameter_file: str | None,
) -> None:
    rows = select_rows(read_csv(recorded_features_file), settings.where, f"recording {settings.recording}")
    table, extraction = read_csv(changed_features_file), read_extraction(parameter_file)
    features, not_compared = compared(table, rows, dimensions, stored_offset_hu, extraction)
    data = responses(table, rows, features, read_nifti(image_file).grid, settings.rois)
    found = diagnose_features(name, data, not_compared, settings.margin_sd)
    write_diagnosis(
        output, found.content, overlay(data, found.content), feature_diagnosis_page(found), found.before.maps
    )
    log.info("%s", console_text(found.content))
    print(console_text(found.content))


if "snakemake" in globals():
    with job(snakemake):
        main(
            changed_features_file=snakemake.input.properties,
            recorded_features_file=snakemake.input.recorded,
            image_file=snakemake.input.image,
            output=snakemake.output,
            name=snakemake.wildcards.comparison,
            settings=from_mapping(Comparison, snakemake.params.settings),
            dimensions=snakemake.params.dimensions,
            stored_offset_hu=snakemake.params.stored_offset_hu,
            parameter_file=snakemake.params.parameters["path"],
        )
