# Pages for a browser, each in one file.
localrules:
    viewer,


def optimal_images(wildcards):
    """All repeats of the two images of the figure of scans."""
    if "optimal" not in ANALYSES:
        sys.exit(
            "Error: config: the viewer shows the images of analyses.optimal, which is not there; give it sirt, fbp "
            "and noise"
        )
    return {
        algorithm: images(ANALYSES["optimal"][algorithm], ANALYSES["optimal"]["noise"])
        for algorithm in ("fbp", "sirt")
    }


rule viewer_page:
    """Slices of the input, FBP, SIRT and what they differ by, to flip through."""
    input:
        unpack(optimal_images),
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("viewer.py"),
    output:
        f"{RESULTS}/viewer.html",
    log:
        f"{RESULTS}/logs/viewer.log",
    resources:
        mem_mb=megabytes(volumes=60),
        runtime=15,
    params:
        titles=scan_titles(),
        subtitle=lambda wildcards: "Noise level {noise}. Single scans are of seed 00.".format(
            noise=ANALYSES["optimal"]["noise"]
        ),
    script:
        "../scripts/viewer.py"


rule viewer:
    input:
        rules.viewer_page.output[0],
