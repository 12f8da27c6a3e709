# Diagnosis of features: where recording and simulation differ, and which image property explains it.
comparisons = context.comparisons


rule diagnose_features:
    """Verdict and report of one comparison with a recording's features."""
    input:
        properties=rules.change_properties.output[0],
        recorded=lambda wildcards: comparisons.features(wildcards.comparison),
        image=lambda wildcards: comparisons.images(wildcards.comparison)[0],
        parameters=context.parameter_files,
    output:
        diagnosis=results("diagnosis/{comparison}/diagnosis.json"),
        physics=results("diagnosis/{comparison}/physics.yaml"),
        report=reported("diagnosis/{comparison}/report.html"),
        maps=directory(results("diagnosis/{comparison}/maps")),
    log:
        results("logs/diagnosis/{comparison}/diagnose.log"),
    wildcard_constraints:
        comparison="|".join(context.study.diagnosis.comparisons) or "none",
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        parameters=context.parameters,
        settings=lambda wildcards: to_mapping(
            comparisons.settings[wildcards.comparison]
        ),
        dimensions=lambda wildcards: comparisons.dimensions(wildcards.comparison),
        stored_offset_hu=lambda wildcards: comparisons.stored_offset_hu(
            wildcards.comparison
        ),
        code=code("diagnose_features.py"),
    script:
        "../scripts/diagnose_features.py"
