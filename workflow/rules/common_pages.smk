"""Inputs and titles of the pages and of the images in DICOM."""

from types import SimpleNamespace


def dicom_images():
    """Folders of the images that `snakemake dicom` exports: by default those of the figure of scans."""
    acquired = {
        f"{protocol}/{noise}/seed{seed}"
        for protocol, noise in ACQUISITIONS
        for seed in PLAN.seeds(noise)
    }
    wanted = PLAN.config["dicom"]["images"]
    for image in wanted:
        if image not in acquired:
            raise InputError(
                f"config: dicom.images names {image}, which no analysis asks for; name an image that is made, as the "
                f"folder images has them, such as {min(acquired, default='none')}"
            )
    if not wanted and "optimal" in ANALYSES:
        optimal = ANALYSES["optimal"]
        wanted = [
            f"{optimal[algorithm]}/{optimal['noise']}/seed00"
            for algorithm in ("fbp", "sirt")
        ]
    return [f"{RESULTS}/dicom/{image}" for image in wanted]


def dicom_scan(wildcards):
    """What a series is called and how it was acquired."""
    protocol = PLAN.config["protocols"][wildcards.protocol]
    scan = PLAN.geometry_settings(PLAN.geometry_of(wildcards.protocol))["scan"]
    return {
        "protocol": wildcards.protocol,
        "label": f"{wildcards.protocol} {wildcards.noise} seed {wildcards.seed} (simulated)",
        "description": f"{protocol['algorithm'].upper()} of {protocol['projections']} projections, "
        f"noise level {wildcards.noise}, seed {wildcards.seed}.",
        "source_to_isocentre_mm": scan["source_to_isocentre_mm"],
        "source_to_detector_mm": scan["source_to_detector_mm"],
    }


def exported(wildcards):
    """All that `snakemake dicom` writes."""
    if not DICOM:
        sys.exit(
            "Error: config: nothing to export; name images under dicom.images, as the folder images has them"
        )
    return [f"{image}/{part}" for image in DICOM for part in ("series", "rois.dcm")]


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
        "caption": shipped(WORKFLOW / "report" / f"{caption}.rst"),
        "shown": {
            "section": section,
            "title": title,
            "params": params,
            "wildcards": wildcards,
        },
    }


def table_name(path):
    return os.path.basename(path).removesuffix(".csv")


def place(path):
    """Tables that have a title come in that order, the others after them."""
    name = table_name(path)
    return [*TABLES].index(name) if name in TABLES else len(TABLES)


def diagnoses_there():
    """Reports of diagnoses that have been made, and when: no inputs, as a report of the study starts none."""
    named = [*DIAGNOSED, *PLAN.config["diagnosis"]["comparisons"]]
    paths = [f"{RESULTS}/diagnosis/{name}/report.html" for name in named]
    return {path: os.path.getmtime(path) for path in paths if os.path.exists(path)}
