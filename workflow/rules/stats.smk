rule stability:
    """W over pairs of groups and pairs of classes, for every feature."""
    input:
        features=rules.merge_features.output[0],
        code=context.code("stability.py"),
    output:
        context.file("stability"),
    log:
        context.log("stability"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **context.selections.grouped,
        statistics=context.config["statistics"],
    script:
        "../scripts/stability.py"


rule trust:
    """The stability of every feature with its interval, and what more repeats would give."""
    input:
        features=rules.merge_features.output[0],
        code=context.code("trust.py"),
    output:
        report(context.file("trust"), **context.reported("trust")),
    log:
        context.log("trust"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        **context.selections.grouped,
        statistics=context.config["statistics"],
        cut_offs=context.selections.cut_offs,
        sharing=context.selections.sharing(),
    script:
        "../scripts/trust.py"


rule physics_change:
    """The stability of every feature with the study's physics beside that without."""
    input:
        features=rules.merge_features.output[0],
        trust=rules.trust.output[0],
        code=context.code("physics_change.py"),
    output:
        report(context.file("physics_change"), **context.reported("physics_change")),
    log:
        context.log("physics_change"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        groups=context.plan.groups_without_physics(),
        noise=context.selections.grouped["noise"],
        seeds=context.selections.grouped["seeds"],
        statistics=context.config["statistics"],
        cut_offs=context.selections.cut_offs,
        sharing=context.selections.sharing(context.plan.groups_without_physics()),
    script:
        "../scripts/physics_change.py"


rule stability_measures:
    """ICC, CCC and coefficients of variation beside W, and which features are stable by which."""
    input:
        features=rules.merge_features.output[0],
        trust=rules.trust.output[0],
        code=context.code("stability_measures.py"),
    output:
        measures=report(
            context.file("stability_measures"),
            **context.reported("stability_measures"),
        ),
        features=report(
            context.file("stable_features"), **context.reported("stable_features")
        ),
    log:
        context.log("stability_measures"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **context.selections.grouped,
        cut_offs=context.selections.cut_offs,
    script:
        "../scripts/stability_measures.py"


rule top_features:
    """The ten best features beside the paper's."""
    input:
        stability=rules.stability.output[0],
        published=context.resource("published_top_features.csv"),
        scores=context.resource("ct_phantom4radiomics_draws.csv"),
        code=context.code("top_features.py"),
    output:
        report(context.file("top_features"), **context.reported("top_features")),
    log:
        context.log("top_features"),
    group:
        "analyses"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seeds=context.selections.grouped["seeds"],
        with_measured=context.config["measured"]["overlay"],
    script:
        "../scripts/top_features.py"


rule overlap:
    """How many of the best features are also the measured phantom's best."""
    input:
        features=rules.merge_features.output[0],
        scores=context.resource("ct_phantom4radiomics_draws.csv"),
        code=context.code("overlap.py"),
    output:
        context.file("overlap"),
    log:
        context.log("overlap"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **context.selections.grouped,
        statistics=context.config["statistics"],
        recording=None,
    script:
        "../scripts/overlap.py"


rule pca:
    """The first two principal components of all images and ROIs of a selection of protocols."""
    input:
        features=rules.merge_features.output[0],
        measured=lambda wildcards: context.selections.reference_tables(wildcards.pca),
        parameters=context.parameter_files,
        code=context.code("pca.py"),
    output:
        table=context.file("pca"),
        separability=context.file("separability"),
    log:
        context.log("pca_{pca}"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        parameters=context.parameters,
        selection=lambda wildcards: context.selections.components(wildcards.pca),
        pca=lambda wildcards: context.selections.fitted(wildcards.pca),
        measured=context.config["measured"],
        recordings=lambda wildcards: context.selections.references(wildcards.pca),
        by=lambda wildcards: context.selections.markers(wildcards.pca),
        conditions=lambda wildcards: {
            name: context.recordings.conditions(name)
            for name in context.selections.references(wildcards.pca)
        },
    script:
        "../scripts/pca.py"


rule noise_calibration:
    """Variance over repeats, averaged over voxels, against the noise level."""
    input:
        images=context.selections.calibration_images(),
        rois=context.selections.calibration_rois()[0],
        masks=context.selections.calibration_rois()[1],
        code=context.code("noise_calibration.py"),
    output:
        context.file("noise_calibration"),
    log:
        context.log("noise_calibration"),
    group:
        "calibration"
    resources:
        mem_mb=context.megabytes(volumes=12),
        runtime=lambda wildcards, attempt: attempt
        * context.minutes(
            "noise_calibration",
            context.sizes.images(len(context.selections.calibration)),
        ),
    params:
        protocols=context.selections.calibrated,
        acquisitions=context.selections.calibration_acquisitions(),
    script:
        "../scripts/noise_calibration.py"


rule parquet:
    """Every table as Parquet too."""
    input:
        tables=context.tables(),
        code=context.code("parquet.py"),
    output:
        context.parquet_tables(),
    log:
        context.log("parquet"),
    resources:
        mem_mb=2000,
        runtime=15,
    script:
        "../scripts/parquet.py"
