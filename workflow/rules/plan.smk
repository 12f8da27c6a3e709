# What the study would cost, before anyone pays. docs/how-to/cluster.md says what it rests on.
rule plan_files:
    """Jobs, core-hours and bytes of the study that is configured, from measured rates; how long diagnoses take."""
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
        config=context.config,
        engine=context.engine,
        # Of the cores that are given here.
        diagnoses=lambda wildcards: context.diagnosis.forecasts(
            workflow.resource_settings.cores
        ),
        code=code("plan.py"),
    script:
        "../scripts/plan.py"


rule plan:
    """The same, printed."""
    input:
        text=rules.plan_files.output.text,
    log:
        results("logs/plan_printed.log"),
    localrule: True
    script:
        "../scripts/show.py"
