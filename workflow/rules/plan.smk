# What the study would cost, before anyone pays. docs/cluster.md says what it rests on.
rule plan_files:
    """Jobs, core-hours and bytes of the study that is configured, from measured rates."""
    input:
        rates=resource("rates.yaml"),
        layout=(
            present(layout_file())
            if PLAN.config["phantom"]["source"] == "synthetic"
            else []
        ),
        code=code("plan.py"),
    output:
        table=f"{RESULTS}/plan.csv",
        totals=f"{RESULTS}/plan.json",
        text=f"{RESULTS}/plan.txt",
    log:
        f"{RESULTS}/logs/plan.log",
    localrule: True
    params:
        config=PLAN.config,
        engine=ENGINE,
    script:
        "../scripts/plan.py"


rule plan:
    """The same, printed."""
    input:
        text=rules.plan_files.output.text,
    log:
        f"{RESULTS}/logs/plan_printed.log",
    localrule: True
    script:
        "../scripts/show.py"
