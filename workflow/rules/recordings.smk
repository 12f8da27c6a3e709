# What others have measured: read, drawn, and aligned with the phantom.
rule recording_summary:
    """Read and check one recording; what was found, what is known of the scan, what is missing."""
    input:
        files=lambda wildcards: context.recordings.sources(wildcards.recording),
        schema=context.schema("recording.schema.yaml"),
        parameters=context.parameter_files,
        code=context.code("recording_summary.py"),
    output:
        context.file("summary"),
    log:
        context.log("recording_summary/{recording}"),
    resources:
        mem_mb=lambda wildcards: context.recordings.megabytes(wildcards.recording),
        runtime=30,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
        voxel_mm=context.config["grid"]["spacing_mm"],
    script:
        "../scripts/recording_summary.py"


rule figure_recording:
    """What a recording of projections or images looks like."""
    input:
        files=lambda wildcards: context.recordings.sources(wildcards.recording),
        code=context.code("figures/recording.py"),
    output:
        png=report(
            context.file("figure_recording", ".png"),
            **context.reported("figure_recording"),
        ),
        pdf=context.file("figure_recording", ".pdf"),
    log:
        context.log("figure_recording/{recording}"),
    resources:
        mem_mb=lambda wildcards: context.recordings.megabytes(wildcards.recording),
        runtime=30,
    params:
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
    script:
        "../scripts/figures/recording.py"


rule recordings:
    """All configured recordings in one table, printed."""
    input:
        summaries=context.recordings.summaries(),
        figures=context.recordings.pictures(),
        code=context.code("recordings.py"),
    output:
        context.file("recordings"),
    log:
        context.log("recordings"),
    localrule: True
    resources:
        mem_mb=500,
        runtime=5,
    params:
        names=context.recordings.names,
    script:
        "../scripts/recordings.py"


rule align_recording:
    """Where the phantom lies in a recording of images, and its ROIs on the recording's own grid."""
    input:
        files=lambda wildcards: context.recordings.sources(wildcards.recording),
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=context.code("align_recording.py"),
    output:
        alignment=context.file("alignment"),
        image=context.file("recorded_image"),
        table=context.file("recorded_table"),
        rois=directory(context.file("recorded_rois")),
    log:
        context.log("align_recording/{recording}"),
    resources:
        mem_mb=lambda wildcards: context.aligned_megabytes(wildcards.recording),
        runtime=120,
    params:
        folder=lambda wildcards: context.recordings.folder(wildcards.recording),
        phantom=context.config["phantom"],
    script:
        "../scripts/align_recording.py"


rule figure_alignment:
    """A recording with the phantom's outlines."""
    input:
        alignment=rules.align_recording.output.alignment,
        image=rules.align_recording.output.image,
        rois=rules.align_recording.output.table,
        masks=rules.align_recording.output.rois,
        phantom=rules.phantom.output.image,
        code=context.code("figures/alignment.py"),
    output:
        png=report(
            context.file("figure_alignment", ".png"),
            **context.reported("figure_alignment"),
        ),
        pdf=context.file("figure_alignment", ".pdf"),
    log:
        context.log("figure_alignment/{recording}"),
    resources:
        mem_mb=2000,
        runtime=10,
    script:
        "../scripts/figures/alignment.py"


rule alignment:
    """All configured recordings of images, aligned."""
    input:
        context.recordings.alignments(),
    localrule: True
