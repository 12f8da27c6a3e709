selections = context.selections


rule noise_control:
    """Features of the phantom with white noise of the variance of each protocol, without a scan."""
    input:
        images=sum(selections.noise_control_images().values(), []),
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        parameters=context.parameter_files,
    output:
        results("noise_control.csv"),
    log:
        results("logs/noise_control.log"),
    group:
        "analyses"
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=lambda wildcards, input, attempt: attempt
        * context.minutes("extract", context.sizes.images(len(input.images))),
    params:
        groups=context.plan.groups(),
        seeds=selections.compared_images()["seeds"],
        images=selections.noise_control_images(),
        study_seed=context.study.seed,
        parameters=context.parameters,
        code=code("noise_control.py"),
    script:
        "../scripts/noise_control.py"


rule stability:
    """W over pairs of groups and pairs of tissue classes, for each feature; controls of the means."""
    input:
        features=rules.merge_features.output[0],
        noise_control=(
            rules.noise_control.output[0] if selections.noise_control else []
        ),
    output:
        scores=results("tables/stability.csv"),
        controls=reported("tables/controls.csv"),
    log:
        results("logs/stability.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        images=selections.compared_images(),
        statistics=to_mapping(context.study.statistics),
        code=code("stability.py"),
    script:
        "../scripts/stability.py"


rule trust:
    """Robustness of each feature against each kind of change; parameter file of the robust features."""
    input:
        features=rules.merge_features.output[0],
        extraction=results("extraction.csv") if context.plan.compares_extraction else [],
        parameters=context.parameter_files,
    output:
        table=reported("tables/trust.csv"),
        features=results("tables/robust_features.yaml"),
    log:
        results("logs/trust.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        images=selections.compared_images(),
        statistics=to_mapping(context.study.statistics),
        cut_offs=selections.cut_offs,
        sharing=selections.sharing(),
        pairs=context.pages.setting_pairs(),
        parameters=context.parameters,
        code=code("trust.py"),
    script:
        "../scripts/trust.py"


rule physics_change:
    """Stability of each feature with the physics of the study and without."""
    input:
        features=rules.merge_features.output[0],
        trust=rules.trust.output[0],
    output:
        reported("tables/physics_change.csv"),
    log:
        results("logs/physics_change.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        images=selections.compared_images(context.plan.groups_without_physics()),
        statistics=to_mapping(context.study.statistics),
        cut_offs=selections.cut_offs,
        sharing=selections.sharing(context.plan.groups_without_physics()),
        code=code("physics_change.py"),
    script:
        "../scripts/physics_change.py"


rule stability_measures:
    """ICC, CCC and coefficients of variation besides W; stable features by each measure."""
    input:
        features=rules.merge_features.output[0],
        trust=rules.trust.output.table,
    output:
        measures=reported("tables/stability_measures.csv"),
        features=reported("tables/stable_features.csv"),
    log:
        results("logs/stability_measures.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        images=selections.compared_images(),
        cut_offs=selections.cut_offs,
        code=code("stability_measures.py"),
    script:
        "../scripts/stability_measures.py"


rule extraction_settings:
    """Robustness and discriminative power of every feature with every extraction setting."""
    input:
        features=rules.merge_features.output[0],
        settings=selections.setting_tables(),
    output:
        features=results("extraction.csv"),
        settings=reported("tables/extraction_settings.csv"),
        choice=reported("tables/extraction_choice.csv"),
    log:
        results("logs/extraction_settings.log"),
    group:
        "analyses"
    resources:
        mem_mb=4000,
        runtime=30,
    params:
        images=context.plan.extracted_images(),
        seeds=context.plan.extracted_repeats() if context.plan.variations else 0,
        variations=to_mapping(context.plan.variations),
        statistics=to_mapping(context.study.statistics),
        code=code("extraction_settings.py"),
    script:
        "../scripts/extraction_settings.py"


rule top_features:
    """The ten best features of the study and of the paper."""
    input:
        stability=rules.stability.output.scores,
        published=resource("published_top_features.csv"),
        scores=resource("ct_phantom4radiomics_draws.csv"),
    output:
        reported("tables/top_features.csv"),
    log:
        results("logs/top_features.log"),
    group:
        "analyses"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seeds=selections.compared_images()["seeds"],
        measured_acquisitions=selections.measured_acquisitions,
        code=code("top_features.py"),
    script:
        "../scripts/top_features.py"


rule overlap:
    """Number of best features that are also among the best of the measured phantom."""
    input:
        features=rules.merge_features.output[0],
        scores=resource("ct_phantom4radiomics_draws.csv"),
    output:
        results("tables/overlap.csv"),
    log:
        results("logs/overlap.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        images=selections.compared_images(),
        statistics=to_mapping(context.study.statistics),
        measured_acquisitions=selections.measured_acquisitions,
        code=code("overlap.py"),
    script:
        "../scripts/overlap.py"


rule pca:
    """First two principal components over the images and ROIs of a selection of protocols."""
    input:
        features=rules.merge_features.output[0],
        measured=lambda wildcards: selections.reference_tables(wildcards.pca),
        parameters=context.parameter_files,
    output:
        table=results("tables/pca_{pca}.csv"),
        separability=results("tables/separability_{pca}.csv"),
    log:
        results("logs/pca_{pca}.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        parameters=context.parameters,
        settings=lambda wildcards: to_mapping(context.study.analyses.pca[wildcards.pca]),
        seeds=lambda wildcards: context.plan.repeats(
            context.study.analyses.pca[wildcards.pca].noise
        ),
        measured=to_mapping(context.study.measured),
        conditions=lambda wildcards: {
            name: context.recordings.conditions(name)
            for name in context.study.analyses.pca[wildcards.pca].recordings
        },
        code=code("pca.py"),
    script:
        "../scripts/pca.py"


rule noise_calibration:
    """Variance over repeats, averaged over voxels, for each noise level."""
    input:
        images=selections.calibration_images(),
        rois=selections.calibration_rois()[0],
        masks=selections.calibration_rois()[1],
    output:
        results("tables/noise_calibration.csv"),
    log:
        results("logs/noise_calibration.log"),
    group:
        "calibration"
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=lambda wildcards, input, attempt: attempt
        * context.minutes("noise_calibration", context.sizes.images(len(input.images))),
    params:
        protocols=selections.calibrated,
        acquisitions=selections.calibration_acquisitions(),
        code=code("noise_calibration.py"),
    script:
        "../scripts/noise_calibration.py"


rule fixed_pattern:
    """Variance of every ROI in each group: the pattern that all repeats share, and the noise."""
    input:
        images=sum(selections.pattern_images().values(), []),
        rois=sorted({table for table, _ in selections.pattern_rois().values()}),
        masks=sorted({masks for _, masks in selections.pattern_rois().values()}),
    output:
        reported("tables/fixed_pattern.csv"),
    log:
        results("logs/fixed_pattern.log"),
    group:
        "calibration"
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=lambda wildcards, input, attempt: attempt
        * context.minutes("noise_calibration", context.sizes.images(len(input.images))),
    params:
        image_files=selections.pattern_images(),
        roi_files={
            name: table for name, (table, _) in selections.pattern_rois().items()
        },
        code=code("fixed_pattern.py"),
    script:
        "../scripts/fixed_pattern.py"


rule parquet:
    """All tables as Parquet."""
    input:
        tables=context.tables(),
    output:
        context.parquet_tables(),
    log:
        results("logs/parquet.log"),
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        code=code("parquet.py"),
    script:
        "../scripts/parquet.py"
