"""Features of the simulated images with one property changed at a time, for attribution and diagnosis."""

import pandas as pd

from virtual_phantom import phantom
from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.features.changes import property_tables
from virtual_phantom.diagnosis.features.properties import folds
from virtual_phantom.features.names import MEAN
from virtual_phantom.features.parameters import read_parameters
from virtual_phantom.io import files, volumes
from virtual_phantom.recordings.reference import select_rows
from virtual_phantom.statistics.comparison import common_rois
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    recorded = select_rows(files.read_csv(snakemake.input.recorded), params.where, f"recording {params.recording}")
    parameters = read_parameters(**params.parameters)
    if MEAN not in parameters.features:
        raise InputError(
            f"{parameters.source}: does not ask for {MEAN}, which attribution and diagnosis of features need; add "
            "firstorder to featureClass and Original to imageType"
        )
    images, grid = volumes.read_repeats(snakemake.input.images)
    rois, masks = phantom.read_masks(snakemake.input.rois, grid)
    chosen = common_rois(rois, recorded, params.rois)
    classes = rois.set_index("roi")["tissue_class"]
    fold_of = folds({roi: classes[roi] for roi in chosen})
    tables = []
    regions = {roi: masks[roi] for roi in chosen}
    made = property_tables(images, grid, regions, fold_of, recorded, params.voxel_mm, parameters)
    for table in made:
        tables.append(table)
        log.info("%s %g", table["property"].iloc[0], table["strength"].iloc[0])
    whole = pd.concat(tables, ignore_index=True)
    files.write_csv(whole.assign(tissue_class=whole["roi"].map(classes)), snakemake.output[0])
