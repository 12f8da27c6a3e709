"""Fail if a diagnosis has a verdict of diagnosis.fail_on."""

import json
from collections.abc import Sequence

from virtual_phantom.base.errors import InputError
from virtual_phantom.io.files import read_text
from virtual_phantom.study.job import job


def main(*, diagnoses: Sequence[str], fail_on: Sequence[str]) -> None:
    failing = []
    for path in diagnoses:
        content = json.loads(read_text(path))
        if content["verdict"] in fail_on:
            name = content.get("recording", content.get("scanner"))
            failing.append(f"{name} ({content['verdict']})")
    if failing:
        raise InputError(f"verdicts of diagnosis.fail_on: {', '.join(failing)}; all outputs are written")


if "snakemake" in globals():
    with job(snakemake):
        main(diagnoses=snakemake.input, fail_on=snakemake.params.fail_on)
