"""Look whether a recording is described right, before any physics is fitted."""

import json

from virtual_phantom.diagnosis.core.asked import Asked
from virtual_phantom.diagnosis.setup.recorded import set_up
from virtual_phantom.diagnosis.setup.verdict import NOT_LOOKED, doubted
from virtual_phantom.io.files import write_text
from virtual_phantom.recordings.reading import load
from virtual_phantom.study.job import job

with job(snakemake) as log:
    asked = Asked.of(snakemake.params.model, snakemake.input.get("phantom"), snakemake.threads)
    recording = load(asked.folder)
    found = set_up(recording, asked).content if doubted(recording, asked) else NOT_LOOKED
    write_text(json.dumps(found, indent=1, allow_nan=False) + "\n", snakemake.output[0])
    log.info("%s: %s %s", recording.name, found["kind"], found["mistakes"])
