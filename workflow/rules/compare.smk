# Simulation and recordings side by side: matched noise, features, overlap.
rule recording_features:
    """Features of a recording in HU, one row per image and ROI."""
    input:
        unpack(lambda wildcards: context.recordings.inputs(wildcards.recording)),
        parameters=context.parameter_files,
        code=context.code("recording_features.py"),
    output:
        context.file("recorded_features"),
    log:
        context.log("recording_features/{recording}"),
    resources:
        mem_mb=lambda wildcards: context.recordings.megabytes(wildcards.recording),
        runtime=120,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
    script:
        "../scripts/recording_features.py"


rule match_noise:
    """The A of a noise level that is to meet a recording."""
    input:
        calibration=rules.noise_calibration.output[0],
        recorded=lambda wildcards: context.comparisons.met_features(wildcards.noise),
        code=context.code("match_noise.py"),
    output:
        context.file("matched_level"),
    log:
        context.log("match_noise/{noise}"),
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        meets=lambda wildcards: context.comparisons.met(wildcards.noise),
    script:
        "../scripts/match_noise.py"


rule matched_noise:
    """How well the matched levels meet their recordings."""
    input:
        levels=context.acquisitions.level_files(context.acquisitions.matched()),
        features=rules.merge_features.output[0],
        code=context.code("matched_noise.py"),
    output:
        report(context.file("matched_noise"), **context.reported("matched_noise")),
    log:
        context.log("matched_noise"),
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/matched_noise.py"


rule compare:
    """Every feature and ROI of one protocol and noise level against a recording."""
    input:
        features=rules.merge_features.output[0],
        recorded=lambda wildcards: context.comparisons.features(wildcards.comparison),
        parameters=context.parameter_files,
        code=context.code("compare.py"),
    output:
        cells=context.file("comparison"),
        features=context.file("comparison_features"),
        families=context.file("comparison_families"),
    log:
        context.log("compare/{comparison}"),
    wildcard_constraints:
        comparison="|".join(context.comparisons.settings) or "none",
    resources:
        mem_mb=1500,
        runtime=15,
    params:
        parameters=context.parameters,
        recording=lambda wildcards: context.comparisons.recording(wildcards.comparison),
        where=lambda wildcards: context.comparisons.asked(wildcards.comparison, "where"),
        protocol=lambda wildcards: context.comparisons.asked(
            wildcards.comparison, "protocol"
        ),
        noise=lambda wildcards: context.comparisons.asked(wildcards.comparison, "noise"),
        seeds=lambda wildcards: context.comparisons.repeats(wildcards.comparison),
        rois=lambda wildcards: context.comparisons.asked(wildcards.comparison, "rois"),
        margin_sd=lambda wildcards: context.comparisons.asked(
            wildcards.comparison, "margin_sd"
        ),
    script:
        "../scripts/compare.py"


rule figure_comparison:
    """Heat map of one comparison."""
    input:
        cells=rules.compare.output.cells,
        features=rules.compare.output.features,
        code=context.code("figures/comparison.py"),
    output:
        png=report(
            context.file("figure_comparison", ".png"),
            **context.reported("figure_comparison"),
        ),
        pdf=context.file("figure_comparison", ".pdf"),
    log:
        context.log("figure_comparison/{comparison}"),
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=lambda wildcards: context.comparisons.title(wildcards.comparison),
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/comparison.py"


rule change_properties:
    """Features of the simulated images with one property changed at a time."""
    input:
        images=lambda wildcards: context.comparisons.images(wildcards.comparison),
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        recorded=lambda wildcards: context.comparisons.features(wildcards.comparison),
        effects=context.effect_code(*context.diagnosis.properties),
        parameters=context.parameter_files,
        code=context.code("change_properties.py"),
    output:
        context.file("properties"),
    log:
        context.log("change_properties/{comparison}"),
    wildcard_constraints:
        comparison="|".join(context.comparisons.settings) or "none",
    resources:
        mem_mb=context.megabytes(volumes=60),
        runtime=60,
    params:
        parameters=context.parameters,
        recording=lambda wildcards: context.comparisons.recording(wildcards.comparison),
        where=lambda wildcards: context.comparisons.asked(wildcards.comparison, "where"),
        rois=lambda wildcards: context.comparisons.asked(wildcards.comparison, "rois"),
        voxel_mm=lambda wildcards: context.comparisons.voxel_mm(wildcards.comparison),
    script:
        "../scripts/change_properties.py"


rule attribute:
    """Which property of the images explains that features miss a recording's."""
    input:
        properties=rules.change_properties.output[0],
        recorded=lambda wildcards: context.comparisons.features(wildcards.comparison),
        image=lambda wildcards: context.comparisons.images(wildcards.comparison)[0],
        parameters=context.parameter_files,
        code=context.code("attribute.py"),
    output:
        properties=context.file("attribution"),
        cells=context.file("attribution_cells"),
    log:
        context.log("attribute/{comparison}"),
    wildcard_constraints:
        comparison="|".join(context.comparisons.settings) or "none",
    resources:
        mem_mb=1500,
        runtime=30,
    params:
        parameters=context.parameters,
        recording=lambda wildcards: context.comparisons.recording(wildcards.comparison),
        where=lambda wildcards: context.comparisons.asked(wildcards.comparison, "where"),
        rois=lambda wildcards: context.comparisons.asked(wildcards.comparison, "rois"),
        margin_sd=lambda wildcards: context.comparisons.asked(
            wildcards.comparison, "margin_sd"
        ),
        dimensions=lambda wildcards: context.comparisons.dimensions(
            wildcards.comparison
        ),
        stored_offset_hu=lambda wildcards: context.comparisons.stored_offset_hu(
            wildcards.comparison
        ),
    script:
        "../scripts/attribute.py"


rule figure_attribution:
    """What each property explains, by family of features."""
    input:
        table=rules.attribute.output.properties,
        code=context.code("figures/attribution.py"),
    output:
        png=report(
            context.file("figure_attribution", ".png"),
            **context.reported("figure_attribution"),
        ),
        pdf=context.file("figure_attribution", ".pdf"),
    log:
        context.log("figure_attribution/{comparison}"),
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        title=lambda wildcards: context.comparisons.title(wildcards.comparison),
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/attribution.py"


rule recording_scores:
    """Stability and discriminative power of a recording's features."""
    input:
        files=lambda wildcards: context.recordings.sources(wildcards.recording),
        parameters=context.parameter_files,
        code=context.code("recording_scores.py"),
    output:
        context.file("scores"),
    log:
        context.log("recording_scores/{recording}"),
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
        where=lambda wildcards: context.selections.scored(wildcards.recording),
        repeats=context.selections.grouped["seeds"],
        statistics=context.config["statistics"],
    script:
        "../scripts/recording_scores.py"


rule stability_beside:
    """Every feature's stability over the study's groups, and over the conditions of a recording."""
    input:
        stability=rules.stability.output[0],
        scores=rules.recording_scores.output[0],
        code=context.code("stability_beside.py"),
    output:
        report(context.file("stability_beside"), **context.reported("stability_beside")),
    log:
        context.log("stability_beside/{recording}"),
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/stability_beside.py"


use rule overlap as overlap_recording with:
    input:
        features=rules.merge_features.output[0],
        scores=rules.recording_scores.output[0],
        code=context.code("overlap.py"),
    output:
        context.file("overlap_recording"),
    log:
        context.log("overlap/{recording}"),
    params:
        **context.selections.grouped,
        statistics=context.config["statistics"],
        recording=lambda wildcards: wildcards.recording,


use rule figure_overlap as figure_overlap_recording with:
    input:
        table=rules.overlap_recording.output[0],
        code=context.code("figures/overlap.py"),
    output:
        png=report(
            context.file("figure_overlap_recording", ".png"),
            **context.reported("figure_overlap_recording"),
        ),
        pdf=context.file("figure_overlap_recording", ".pdf"),
    log:
        context.log("figure_overlap/{recording}"),
