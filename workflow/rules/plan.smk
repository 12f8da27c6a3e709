# Forecast of the cost of a study (docs/how-to/cluster.md).
rule plan_files:
    """Jobs, core hours and bytes of the configured study, from measured rates, and durations of diagnoses."""
    input:
        rates=resource("rates.yaml"),
        layout=context.phantom.layout_here(),
    output:
        table=results("plan.csv"),
        totals=results("plan.json"),
        text=results("plan.txt"),
    log:
        results("logs/plan.log"),
    localrule: True
    params:
        study=to_mapping(context.study),
        engine=context.engine,
        # For the cores of this run.
        diagnoses=lambda wildcards: context.diagnosis.forecasts(
            workflow.resource_settings.cores
        ),
        code=code("cost_estimate.py"),
    script:
        "../scripts/cost_estimate.py"


rule plan:
    """Print the plan."""
    input:
        text=rules.plan_files.output.text,
    log:
        results("logs/plan_printed.log"),
    localrule: True
    script:
        "../scripts/show.py"
