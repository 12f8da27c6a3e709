def present(*paths):
    """The files at these paths, those in folders too. What is missing is left to the script, which says so in a line."""
    return [
        str(file)
        for path in paths
        if path and os.path.exists(path)
        for file in files_of(path)
    ]


def phantom_sources():
    """Every file that the phantom is made from."""
    settings = PLAN.config["phantom"]
    if settings["source"] == "synthetic":
        return present(settings["layout"])
    ct = settings["ct"]
    regions = [ct.get("labels"), *(roi.get("file") for roi in ct["rois"])]
    return present(ct["image"], *dict.fromkeys(regions))


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
