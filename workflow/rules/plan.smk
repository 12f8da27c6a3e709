# What the study would cost, before anyone pays. docs/how-to/cluster.md says what it rests on.
rule plan_files:
    """Jobs, core-hours and bytes of the study that is configured, from measured rates; how long diagnoses take."""
    input:
        rates=context.resource("rates.yaml"),
        layout=context.phantom.layout_here(),
        code=context.code("plan.py"),
    output:
        table=context.file("plan_table"),
        totals=context.file("plan_totals"),
        text=context.file("plan_text"),
    log:
        context.log("plan"),
    localrule: True
    params:
        config=context.config,
        engine=context.engine,
        # Of the cores that are given here.
        diagnoses=lambda wildcards: context.diagnosis.forecasts(
            workflow.resource_settings.cores
        ),
    script:
        "../scripts/plan.py"


rule plan:
    """The same, printed."""
    input:
        text=rules.plan_files.output.text,
    log:
        context.log("plan_printed"),
    localrule: True
    script:
        "../scripts/show.py"
