PHANTOM = [
    f"phantom/{name}.py"
    for name in (
        "__init__",
        "layout",
        "synthetic",
        "texture",
        "shapes",
        "ct",
        "dicom_series",
        "masks",
        "rois",
    )
]


rule phantom:
    """The object that every scan sees, and its ROIs."""
    input:
        layout=branch(
            PLAN.config["phantom"]["source"] == "synthetic",
            then=PLAN.config["phantom"]["layout"],
        ),
        code=library("geometry.py", "volumes.py", *PHANTOM),
    output:
        image=f"{RESULTS}/phantom/image.nii.gz",
        fine=f"{RESULTS}/phantom/fine.nii.gz",
        table=f"{RESULTS}/phantom/rois.csv",
        rois=directory(f"{RESULTS}/phantom/rois"),
    log:
        f"{RESULTS}/logs/phantom.log",
    resources:
        mem_mb=megabytes(volumes=4, fine=6),
        runtime=30,
    params:
        phantom=PLAN.config["phantom"],
        grid=PLAN.config["grid"],
        seed=PLAN.config["seed"],
    script:
        "../scripts/phantom.py"
