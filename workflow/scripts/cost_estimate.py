"""Write the expected cost of the configured study as a table, as JSON and as text."""

import json
from collections.abc import Mapping, Sequence

from virtual_phantom.base.settings import from_mapping
from virtual_phantom.config.plan import Plan
from virtual_phantom.config.settings import Study
from virtual_phantom.io import files
from virtual_phantom.study.job import job, log


def main(
    *,
    cost_rates_file: str,  # core seconds and bytes per unit of work
    table_file: str,
    totals_file: str,
    text_file: str,
    study: Study,
    engine: str,
    diagnoses: Sequence[Mapping],
) -> None:
    from virtual_phantom.study.costs.rates import read_rates
    from virtual_phantom.study.costs.table import cost_summary, diagnoses_text, plan_text

    table, content = cost_summary(Plan(study), engine, read_rates(cost_rates_file))
    content["diagnoses"] = list(diagnoses)
    files.write_csv(table, table_file)
    files.write_text(json.dumps(content, indent=2) + "\n", totals_file)
    files.write_text(plan_text(table, content) + diagnoses_text(content["diagnoses"]), text_file)
    log.info("%d jobs, %.3f core-hours", content["jobs"], content["core_hours"])


if "snakemake" in globals():
    with job(snakemake):
        main(
            cost_rates_file=snakemake.input.rates,
            table_file=snakemake.output.table,
            totals_file=snakemake.output.totals,
            text_file=snakemake.output.text,
            study=from_mapping(Study, snakemake.params.study),
            engine=snakemake.params.engine,
            diagnoses=snakemake.params.diagnoses,
        )
