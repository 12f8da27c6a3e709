# Simulated images for programs that read DICOM.
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


try:
    DICOM = dicom_images()
except InputError as error:
    sys.exit(f"Error: {error}")


localrules:
    dicom,


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


rule dicom_series:
    """One image as a CT series, its ROIs as a SEG beside it."""
    input:
        image=f"{RESULTS}/images/{{protocol}}/{{noise}}/seed{{seed}}.nii.gz",
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("dicom.py"),
    output:
        series=directory(f"{RESULTS}/dicom/{{protocol}}/{{noise}}/seed{{seed}}/series"),
        rois=f"{RESULTS}/dicom/{{protocol}}/{{noise}}/seed{{seed}}/rois.dcm",
    log:
        f"{RESULTS}/logs/dicom/{{protocol}}/{{noise}}/seed{{seed}}.log",
    resources:
        mem_mb=megabytes(volumes=12),
        runtime=15,
    params:
        scan=dicom_scan,
    script:
        "../scripts/dicom.py"


def exported(wildcards):
    """All that `snakemake dicom` writes."""
    if not DICOM:
        sys.exit(
            "Error: config: nothing to export; name images under dicom.images, as the folder images has them"
        )
    return [f"{image}/{part}" for image in DICOM for part in ("series", "rois.dcm")]


rule dicom:
    """Images as DICOM series."""
    input:
        exported,
