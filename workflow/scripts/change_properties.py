"""Extract features of the simulated images with one image property changed at a time, for the feature diagnosis."""

from collections.abc import Mapping, Sequence

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.features.changes import property_tables
from virtual_phantom.diagnosis.features.properties import folds
from virtual_phantom.features import names as feature_names
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files, volumes
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.statistics.comparison import common_rois
from virtual_phantom.study.job import job, log


def main(
    *,
    recorded_features: str,
    images_files: Sequence[str],
    rois_file: str,
    output: str,
    recording: str,
    conditions: Mapping,
    chosen_rois: Sequence[str] | None,
    voxel_mm: Sequence[float] | None,
    extraction: Mapping,
) -> None:
    recorded = select_rows(files.read_csv(recorded_features), conditions, f"recording {recording}")
    parameters = read_parameters(**extraction)
    if feature_names.MEAN not in parameters.features:
        raise InputError(
            f"{parameters.source}: does not ask for {feature_names.MEAN}, which the diagnosis of features needs; add "
            "firstorder to featureClass and Original to imageType"
        )
    images, grid = volumes.read_repeats(images_files)
    rois, masks = phantom.read_masks(rois_file, grid)
    chosen = common_rois(rois, recorded, chosen_rois)
    classes = rois.set_index("roi")["tissue_class"]
    fold_of = folds({roi: classes[roi] for roi in chosen})
    tables = []
    chosen_masks = {roi: masks[roi] for roi in chosen}
    tables_of_properties = property_tables(images, grid, chosen_masks, fold_of, recorded, voxel_mm, parameters)
    for table in tables_of_properties:
        tables.append(table)
        log.info("%s %g", table["property"].iloc[0], table["strength"].iloc[0])
    all_rows = pd.concat(tables, ignore_index=True)
    files.write_csv(all_rows.assign(tissue_class=all_rows["roi"].map(classes)), output)


if "snakemake" in globals():
    with job(snakemake):
        main(
            recorded_features=snakemake.input.recorded,
            images_files=snakemake.input.images,
            rois_file=snakemake.input.rois,
            output=snakemake.output[0],
            recording=snakemake.params.recording,
            conditions=snakemake.params.where,
            chosen_rois=snakemake.params.rois,
            voxel_mm=snakemake.params.voxel_mm,
            extraction=snakemake.params.parameters,
        )
