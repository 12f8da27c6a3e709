# Pages for a browser, each in one file.
from types import SimpleNamespace


localrules:
    report_page,
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


def shown_figure(path):
    """A figure's section and title, its caption, and what the caption names."""
    name = os.path.basename(path).removesuffix(".png")
    kind, _, rest = name.partition("_")
    params = {
        "threshold": PLAN.config["statistics"]["threshold"],
        "with_measured": PLAN.config["measured"]["overlay"],
        "measured": measured_noise(),
    }
    wildcards, caption = {}, name
    section, title = SECTIONS.get(name, ("Recordings", name.replace("_", " ")))
    if kind == "pca":
        section, title = "Principal components", PCA_TITLES[rest]
        params["title"] = title
    elif kind in ("comparison", "attribution"):
        caption, wildcards = kind, {"comparison": rest}
        params["title"] = comparison_title(SimpleNamespace(**wildcards))
    elif kind == "overlap" and rest:
        caption, wildcards = "overlap_recording", {"recording": rest}
    return {
        "caption": os.path.join("workflow", "report", f"{caption}.rst"),
        "shown": {
            "section": section,
            "title": title,
            "params": params,
            "wildcards": wildcards,
        },
    }


def flat(paths):
    """Paths that may stand in lists of their own, one after another."""
    for path in paths:
        yield from [path] if isinstance(path, str) else path


REPORTED = [path for path in flat(targets()) if path.endswith(".png")]


def table_name(path):
    return os.path.basename(path).removesuffix(".csv")


def place(path):
    """Tables that have a title come in that order, the others after them."""
    name = table_name(path)
    return [*TABLES].index(name) if name in TABLES else len(TABLES)


REPORTED_TABLES = sorted((f"{table}.csv" for table in tables()), key=place)


def diagnoses_there():
    """Reports of diagnoses that have been made, and when: no inputs, as a report of the study starts none."""
    named = [*DIAGNOSED, *PLAN.config["diagnosis"]["comparisons"]]
    paths = [f"{RESULTS}/diagnosis/{name}/report.html" for name in named]
    return {path: os.path.getmtime(path) for path in paths if os.path.exists(path)}


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
