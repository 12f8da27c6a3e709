"""Which property of the images explains features: diagnosis.json, physics.yaml, maps and the report."""

import json
from pathlib import Path

import numpy as np
import yaml

from virtual_phantom import files
from virtual_phantom.diagnosis.feature_report import page
from virtual_phantom.diagnosis.feature_verdict import diagnose_features, overlay
from virtual_phantom.diagnosis.responses import compared, responses
from virtual_phantom.job import job
from virtual_phantom.property_variants import MEAN
from virtual_phantom.recordings.reference import where
from virtual_phantom.volumes import read_nifti

with job(snakemake) as log:
    params, given, output = snakemake.params, snakemake.input, snakemake.output
    recorded = where(files.read_csv(given.recorded), params.where, f"recording {params.recording}")
    table = files.read_csv(given.properties)
    features, not_compared = compared(table, recorded, params.dimensions, params.stored_offset_hu)
    data = responses(table, recorded, features, read_nifti(given.image).grid, params.rois)
    found = diagnose_features(snakemake.wildcards.comparison, data, not_compared, MEAN)
    maps = Path(output.maps)
    maps.mkdir(parents=True, exist_ok=True)
    for domain, values in found.before.maps.items():
        with files.replacing(maps / f"{domain}.npy") as temporary, temporary.open("wb") as file:
            np.save(file, values)
    text = f"# {found.content['sentence']}\n# An overlay of the study: snakemake --configfile physics.yaml\n"
    files.write_text(text + yaml.safe_dump(overlay(data, found.content), sort_keys=False), output.physics)
    files.write_text(page(found), output.report)
    files.write_text(json.dumps(found.content, indent=2) + "\n", output.diagnosis)
    log.info("%s", found.content["sentence"])
    print(found.content["sentence"])
