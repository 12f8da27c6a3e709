"""Describe a suite of the blind validation for other programs: what the diagnosis of each case is given."""

import json
from collections.abc import Mapping

from virtual_phantom.io.files import write_text
from virtual_phantom.physics.effect import load
from virtual_phantom.study.job import job


def main(*, suite_file: str, cases: Mapping[str, Mapping]) -> None:
    tried = sorted({name for case in cases.values() for name in case["effects"]})
    known = {name: {parameter.name: parameter.unit for parameter in load(name).parameters} for name in tried}
    write_text(json.dumps({"cases": cases, "effects": known}, indent=1) + "\n", suite_file)


if "snakemake" in globals():
    with job(snakemake):
        main(
            suite_file=snakemake.output[0],
            cases=snakemake.params.cases,
        )
