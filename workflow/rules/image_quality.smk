# Image quality of phantoms in recordings of images, after AAPM Report 233.
quality = context.quality


rule measure_image_quality:
    """Resolution, noise, HU accuracy and uniformity of one phantom."""
    input:
        unpack(lambda wildcards: quality.inputs(wildcards.quality)),
        schema=context.schema("image_quality.schema.yaml"),
    output:
        document=results("image_quality/{quality}/image_quality.json"),
        report=reported("image_quality/{quality}/report.html"),
        tables=directory(results("image_quality/{quality}/tables")),
        figures=directory(results("image_quality/{quality}/figures")),
    log:
        results("logs/image_quality/{quality}.log"),
    wildcard_constraints:
        quality="|".join(quality.settings) or "none",
    resources:
        mem_mb=lambda wildcards: quality.megabytes(wildcards.quality),
        runtime=30,
    params:
        folders=lambda wildcards: quality.folders(wildcards.quality),
        settings=lambda wildcards: to_mapping(quality.settings[wildcards.quality]),
        code=code("image_quality.py"),
    script:
        "../scripts/image_quality.py"


rule image_quality:
    """Measure the image quality of all phantoms under image_quality."""
    input:
        quality.all(),
    localrule: True
