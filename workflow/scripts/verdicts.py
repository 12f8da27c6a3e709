"""Fail if a diagnosis has a verdict of diagnosis.fail_on."""

import json

from virtual_phantom.base.errors import InputError
from virtual_phantom.io.files import read_text
from virtual_phantom.study.job import job

with job(snakemake):
    failing = []
    for path in snakemake.input:
        content = json.loads(read_text(path))
        if content["verdict"] in snakemake.params.fail_on:
            name = content.get("recording", content.get("scanner"))
            failing.append(f"{name} ({content['verdict']})")
    if failing:
        raise InputError(f"verdicts of diagnosis.fail_on: {', '.join(failing)}; all outputs are written")
