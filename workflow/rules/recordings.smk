# What others have measured: read, drawn, and aligned with the phantom.
recordings = context.recordings


rule recording_summary:
    """Read and check one recording; what was found, what is known of the scan, what is missing."""
    input:
        files=lambda wildcards: recordings.sources(wildcards.recording),
        schema=context.schema("recording.schema.yaml"),
        parameters=context.parameter_files,
    output:
        results("recordings/{recording}/summary.json"),
    log:
        results("logs/recording_summary/{recording}.log"),
    resources:
        mem_mb=lambda wildcards: recordings.megabytes(wildcards.recording),
        runtime=30,
    params:
        parameters=context.parameters,
        folder=lambda wildcards: recordings.folder(wildcards.recording),
        voxel_mm=context.config["grid"]["spacing_mm"],
        code=code("recording_summary.py"),
    script:
        "../scripts/recording_summary.py"


rule figure_recording:
    """What a recording of projections or images looks like."""
    input:
        files=lambda wildcards: recordings.sources(wildcards.recording),
    output:
        png=reported("figures/recording_{recording}.png"),
        pdf=results("figures/recording_{recording}.pdf"),
    log:
        results("logs/figure_recording/{recording}.log"),
    resources:
        mem_mb=lambda wildcards: recordings.megabytes(wildcards.recording),
        runtime=30,
    params:
        folder=lambda wildcards: recordings.folder(wildcards.recording),
        code=code("figures/recording.py"),
    script:
        "../scripts/figures/recording.py"


rule recordings:
    """All configured recordings in one table, printed."""
    input:
        summaries=recordings.summaries(),
        figures=recordings.pictures(),
    output:
        results("recordings/recordings.csv"),
    log:
        results("logs/recordings.log"),
    localrule: True
    resources:
        mem_mb=500,
        runtime=5,
    params:
        names=recordings.names,
        code=code("recordings.py"),
    script:
        "../scripts/recordings.py"


rule align_recording:
    """Where the phantom lies in a recording of images, and its ROIs on the recording's own grid."""
    input:
        files=lambda wildcards: recordings.sources(wildcards.recording),
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
    output:
        alignment=results("recordings/{recording}/alignment.json"),
        image=results("recordings/{recording}/image.nii.gz"),
        table=results("recordings/{recording}/rois.csv"),
        rois=directory(results("recordings/{recording}/rois")),
    log:
        results("logs/align_recording/{recording}.log"),
    resources:
        mem_mb=lambda wildcards: context.aligned_megabytes(wildcards.recording),
        runtime=120,
    params:
        folder=lambda wildcards: recordings.folder(wildcards.recording),
        phantom=context.config["phantom"],
        code=code("align_recording.py"),
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
    output:
        png=reported("figures/alignment_{recording}.png"),
        pdf=results("figures/alignment_{recording}.pdf"),
    log:
        results("logs/figure_alignment/{recording}.log"),
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=code("figures/alignment.py"),
    script:
        "../scripts/figures/alignment.py"


rule alignment:
    """All configured recordings of images, aligned."""
    input:
        recordings.alignments(),
    localrule: True
