"""Describe a suite of the blind validation for other programs: what the diagnosis of each case is given."""

import json
from collections.abc import Mapping, Sequence

from virtual_phantom.io.files import write_text
from virtual_phantom.physics.effect import load
from virtual_phantom.study.job import job


def main(*, suite_file: str, cases: Mapping[str, Mapping], effects: Sequence[str]) -> None:
    known = {name: {parameter.name: parameter.unit for parameter in load(name).parameters} for name in sorted(effects)}
    write_text(json.dumps({"cases": cases, "effects": known}, indent=1) + "\n", suite_file)


if "snakemake" in globals():
    with job(snakemake):
        main(
            suite_file=snakemake.output[0],
            cases=snakemake.params.cases,
            effects=snakemake.params.effects,
        )
