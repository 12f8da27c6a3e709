"""Measure the image quality of a phantom: image_quality.json, report, tables and figures."""

from collections.abc import Mapping

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.image_quality.measure import measure
from virtual_phantom.image_quality.settings import ImageQualitySettings
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.report.image_quality import console_text, write_image_quality
from virtual_phantom.study.job import job, log


def main(
    *,
    name: str,
    folders: Mapping[str, str],
    settings: ImageQualitySettings,
    document: str,
    report: str,
    tables: str,
    figures: str,
) -> None:
    found = measure(name, settings, {recording: load_recording(folder) for recording, folder in folders.items()})
    write_image_quality(found, document=document, page=report, tables=tables, pictures=figures)
    log.info("%s", console_text(found.content))
    print(console_text(found.content))


if "snakemake" in globals():
    with job(snakemake):
        main(
            name=snakemake.wildcards.quality,
            folders=snakemake.params.folders,
            settings=from_mapping(ImageQualitySettings, snakemake.params.settings),
            document=snakemake.output.document,
            report=snakemake.output.report,
            tables=snakemake.output.tables,
            figures=snakemake.output.figures,
        )
