# Where features of a recording and of the simulation differ, and which property of the images explains it.
from virtual_phantom.physics.effect import image_effects

DIAGNOSED_COMPARISONS = PLAN.config["diagnosis"]["comparisons"]


rule diagnose_properties:
    """Features of the simulated images with one property changed at a time."""
    input:
        images=compared_images,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        recorded=recorded_features,
        effects=effect_code("photon_flux", *image_effects()),
        code=code("diagnose_properties.py"),
    output:
        f"{RESULTS}/diagnosis/{{comparison}}/properties.csv",
    log:
        f"{RESULTS}/logs/diagnosis/{{comparison}}/properties.log",
    wildcard_constraints:
        comparison="|".join(DIAGNOSED_COMPARISONS) or "none",
    resources:
        mem_mb=megabytes(volumes=60),
        runtime=60,
    params:
        recording=comparison_of("recording"),
        where=comparison_of("where"),
        rois=comparison_of("rois"),
        voxel_mm=lambda wildcards: recorded_content(wildcards)["nominal"].get(
            "voxel_mm"
        ),
    script:
        "../scripts/diagnose_properties.py"


rule diagnose_features:
    """Verdict and report of one comparison with a recording's features."""
    input:
        properties=rules.diagnose_properties.output[0],
        recorded=recorded_features,
        image=lambda wildcards: compared_images(wildcards)[0],
        code=code("diagnose_features.py"),
    output:
        diagnosis=f"{RESULTS}/diagnosis/{{comparison}}/diagnosis.json",
        physics=f"{RESULTS}/diagnosis/{{comparison}}/physics.yaml",
        report=report(
            f"{RESULTS}/diagnosis/{{comparison}}/report.html",
            caption="../report/diagnosis.rst",
            category="Diagnosis",
            labels={"recording": "{comparison}"},
        ),
        maps=directory(f"{RESULTS}/diagnosis/{{comparison}}/maps"),
    log:
        f"{RESULTS}/logs/diagnosis/{{comparison}}/diagnose.log",
    wildcard_constraints:
        comparison="|".join(DIAGNOSED_COMPARISONS) or "none",
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        recording=comparison_of("recording"),
        where=comparison_of("where"),
        rois=comparison_of("rois"),
        dimensions=lambda wildcards: recorded_content(wildcards)
        .get("features", {})
        .get("dimensions", 3),
        stored_offset_hu=lambda wildcards: recorded_content(wildcards)
        .get("features", {})
        .get("stored_offset_hu", 0),
    script:
        "../scripts/diagnose_features.py"
