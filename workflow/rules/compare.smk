# Comparison of the simulation with recordings: matched noise levels, features, overlap.
comparisons = context.comparisons


rule recording_features:
    """Features of a recording in HU, one row per image and ROI."""
    input:
        unpack(lambda wildcards: context.recordings.inputs(wildcards.recording)),
        parameters=context.parameter_files,
    output:
        results("recordings/{recording}/features.csv"),
    log:
        results("logs/recording_features/{recording}.log"),
    resources:
        mem_mb=lambda wildcards: context.recordings.megabytes(wildcards.recording),
        runtime=120,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
        code=code("recording_features.py"),
    script:
        "../scripts/recording_features.py"


rule match_noise:
    """Fit the A of a noise level to the variance of a recording."""
    input:
        calibration=rules.noise_calibration.output[0],
        recorded=lambda wildcards: comparisons.noise_target_features(wildcards.noise),
    output:
        results("noise/{noise}.json"),
    log:
        results("logs/match_noise/{noise}.log"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        meets=lambda wildcards: to_mapping(
            context.study.noise.levels[wildcards.noise].meets
        ),
        code=code("match_noise.py"),
    script:
        "../scripts/match_noise.py"


rule matched_noise:
    """Variance of the matched noise levels and of their recordings."""
    input:
        levels=context.acquisitions.level_files(context.acquisitions.matched()),
        features=rules.merge_features.output[0],
    output:
        reported("tables/matched_noise.csv"),
    log:
        results("logs/matched_noise.log"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        code=code("matched_noise.py"),
    script:
        "../scripts/matched_noise.py"


rule compare:
    """Compare one protocol and noise level with a recording, for each feature and ROI."""
    input:
        features=rules.merge_features.output[0],
        recorded=lambda wildcards: comparisons.features(wildcards.comparison),
        parameters=context.parameter_files,
    output:
        cells=results("tables/comparison_{comparison}.csv"),
        features=results("tables/comparison_{comparison}_features.csv"),
        families=results("tables/comparison_{comparison}_families.csv"),
    log:
        results("logs/compare/{comparison}.log"),
    wildcard_constraints:
        comparison="|".join(comparisons.settings) or "none",
    resources:
        mem_mb=1500,
        runtime=15,
    params:
        parameters=context.parameters,
        settings=lambda wildcards: to_mapping(
            comparisons.settings[wildcards.comparison]
        ),
        seeds=lambda wildcards: comparisons.repeats(wildcards.comparison),
        dimensions=lambda wildcards: comparisons.table_dimensions(wildcards.comparison),
        code=code("compare.py"),
    script:
        "../scripts/compare.py"


rule figure_comparison:
    """Heat map of one comparison."""
    input:
        cells=rules.compare.output.cells,
        features=rules.compare.output.features,
    output:
        png=reported("figures/comparison_{comparison}.png"),
        pdf=results("figures/comparison_{comparison}.pdf"),
    log:
        results("logs/figure_comparison/{comparison}.log"),
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=lambda wildcards: comparisons.title(wildcards.comparison),
        trial=bool(context.study.trial),
        code=code("figures/comparison.py"),
    script:
        "../scripts/figures/comparison.py"


rule change_properties:
    """Features of the simulated images, with one image property changed at a time."""
    input:
        images=lambda wildcards: comparisons.images(wildcards.comparison),
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        recorded=lambda wildcards: comparisons.features(wildcards.comparison),
        parameters=context.parameter_files,
    output:
        results("diagnosis/{comparison}/properties.csv"),
    log:
        results("logs/change_properties/{comparison}.log"),
    wildcard_constraints:
        comparison="|".join(comparisons.settings) or "none",
    resources:
        mem_mb=context.megabytes(volumes=60),
        runtime=60,
    params:
        parameters=context.parameters,
        recording=lambda wildcards: comparisons.settings[wildcards.comparison].recording,
        where=lambda wildcards: comparisons.settings[wildcards.comparison].where,
        rois=lambda wildcards: comparisons.settings[wildcards.comparison].rois,
        voxel_mm=lambda wildcards: comparisons.voxel_mm(wildcards.comparison),
        code=code("change_properties.py", context.diagnosis.properties),
    script:
        "../scripts/change_properties.py"


rule recording_scores:
    """Stability and discriminative power of a recording's features."""
    input:
        files=lambda wildcards: context.recordings.sources(wildcards.recording),
        parameters=context.parameter_files,
    output:
        results("recordings/{recording}/scores.csv"),
    log:
        results("logs/recording_scores/{recording}.log"),
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
        where=lambda wildcards: context.selections.score_conditions(wildcards.recording),
        repeats=context.selections.compared_images()["seeds"],
        statistics=to_mapping(context.study.statistics),
        code=code("recording_scores.py"),
    script:
        "../scripts/recording_scores.py"


rule stability_beside:
    """Stability of each feature over the groups of the study and over the conditions of a recording."""
    input:
        stability=rules.stability.output[0],
        scores=rules.recording_scores.output[0],
    output:
        reported("tables/scores_{recording}.csv"),
    log:
        results("logs/stability_beside/{recording}.log"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        code=code("stability_beside.py"),
    script:
        "../scripts/stability_beside.py"


use rule overlap as overlap_recording with:
    input:
        features=rules.merge_features.output[0],
        scores=rules.recording_scores.output[0],
    output:
        results("tables/overlap_{recording}.csv"),
    log:
        results("logs/overlap/{recording}.log"),
    params:
        images=context.selections.compared_images(),
        statistics=to_mapping(context.study.statistics),
        measured_acquisitions=None,
        code=code("overlap.py"),


use rule figure_overlap as figure_overlap_recording with:
    input:
        table=rules.overlap_recording.output[0],
    output:
        png=reported("figures/overlap_{recording}.png"),
        pdf=results("figures/overlap_{recording}.pdf"),
    log:
        results("logs/figure_overlap/{recording}.log"),
