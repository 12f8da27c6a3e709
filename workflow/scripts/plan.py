"""What the configured study would cost, as a table, as JSON and as text."""

import json

from virtual_phantom.io import files
from virtual_phantom.study.job import job

with job(snakemake) as log:
    from virtual_phantom.config.plan import Plan
    from virtual_phantom.study.costs.rates import read_rates
    from virtual_phantom.study.costs.table import cost_summary, diagnoses_text, plan_text

    plan = Plan(dict(snakemake.params.config))
    table, content = cost_summary(plan, snakemake.params.engine, read_rates(snakemake.input.rates))
    content["diagnoses"] = list(snakemake.params.diagnoses)
    files.write_csv(table, snakemake.output.table)
    files.write_text(json.dumps(content, indent=2) + "\n", snakemake.output.totals)
    files.write_text(plan_text(table, content) + diagnoses_text(content["diagnoses"]), snakemake.output.text)
    log.info("%d jobs, %.3f core-hours", content["jobs"], content["core_hours"])
