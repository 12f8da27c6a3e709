rule phantom:
    """The object that every scan sees, and its ROIs."""
    input:
        sources=phantom_sources(),
        code=code("phantom.py"),
    output:
        image=f"{RESULTS}/phantom/image.nii.gz",
        fine=f"{RESULTS}/phantom/fine.nii.gz",
        table=f"{RESULTS}/phantom/rois.csv",
        rois=directory(f"{RESULTS}/phantom/rois"),
    log:
        f"{RESULTS}/logs/phantom.log",
    group:
        "preparation"
    resources:
        mem_mb=megabytes(volumes=4, fine=6),
        runtime=lambda wildcards, attempt: attempt
        * minutes(RATES, "phantom", SIZES.phantom()),
    params:
        phantom=PLAN.config["phantom"],
        grid=PLAN.config["grid"],
        seed=PLAN.config["seed"],
    script:
        "../scripts/phantom.py"
