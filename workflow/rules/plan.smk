# What the study would cost, before anyone pays. docs/cluster.md says what it rests on.
localrules:
    plan,
    plan_files,


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
    script:
        "../scripts/show.py"
