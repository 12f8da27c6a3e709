# Pages for a browser, each in one file.
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
    localrule: True


SECTIONS = {
    "rois": ("Phantom", "Regions of interest"),
    "scans": ("Phantom", "Input, FBP and SIRT"),
    "noise_calibration": ("Noise", "Noise calibration"),
    "stability_discrimination": ("Stability", "Stability and discriminative power"),
    "overlap": ("Stability", "Overlap with the measured phantom"),
}
TABLES = {
    "stable_features": "Stable features by measure",
    "stability_measures": "Measures of stability",
    "stability": "Stability and discriminative power by W",
    "top_features": "Ten best features",
    "overlap": "Overlap with the measured phantom",
    "noise_calibration": "Noise calibration",
    "matched_noise": "Matched noise levels",
    "features": "All features",
}


REPORTED = [path for path in targets() if path.endswith(".png")]


REPORTED_TABLES = sorted((f"{table}.csv" for table in tables()), key=place)


rule study_report:
    """Figures, tables that sort and filter, diagnoses and provenance in one page."""
    input:
        figures=REPORTED,
        captions=[shown_figure(path)["caption"] for path in REPORTED],
        tables=REPORTED_TABLES,
        code=code("report_page.py"),
    output:
        f"{RESULTS}/report.html",
    log:
        f"{RESULTS}/logs/report_page.log",
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        figures=[shown_figure(path)["shown"] for path in REPORTED],
        tables=[
            TABLES.get(table_name(path), table_name(path).replace("_", " "))
            for path in REPORTED_TABLES
        ],
        diagnoses=diagnoses_there(),
        links={"Slices to flip through": "viewer.html"} if "optimal" in ANALYSES else {},
        config=PLAN.config,
    script:
        "../scripts/report_page.py"


rule report_page:
    input:
        rules.study_report.output[0],
        rules.viewer_page.output[0] if "optimal" in ANALYSES else [],
    localrule: True
