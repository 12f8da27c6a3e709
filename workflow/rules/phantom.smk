rule phantom:
    """The object that every scan sees, and its ROIs."""
    input:
        sources=context.phantom.files(),
        code=context.code("phantom.py"),
    output:
        image=context.file("phantom_image"),
        fine=context.file("phantom_fine"),
        table=context.file("phantom_table"),
        rois=directory(context.file("phantom_rois")),
    log:
        context.log("phantom"),
    group:
        "preparation"
    resources:
        mem_mb=context.megabytes(volumes=4, fine=6),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes("phantom", context.sizes.phantom()),
    params:
        phantom=context.config["phantom"],
        grid=context.config["grid"],
        seed=context.config["seed"],
    script:
        "../scripts/phantom.py"
