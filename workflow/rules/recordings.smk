# Recordings of real scans: summary, figures, alignment with the phantom.
recordings = context.recordings


rule recording_summary:
    """Read and check one recording; report its content and missing information on the scan."""
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
        voxel_sizes=context.plan.voxel_sizes,
        code=code("recording_summary.py"),
    script:
        "../scripts/recording_summary.py"


rule figure_recording:
    """Figure of a recording of projections or images."""
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
    """Print a table of all configured recordings."""
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
        names=list(recordings.documents),
        code=code("recordings.py"),
    script:
        "../scripts/recordings.py"


rule align_recording:
    """Align the phantom with a recording of images; ROIs on the grid of the recording."""
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
        mem_mb=lambda wildcards: context.alignment_megabytes(wildcards.recording),
        runtime=120,
    params:
        folder=lambda wildcards: recordings.folder(wildcards.recording),
        phantom=to_mapping(context.study.phantom),
        code=code("align_recording.py"),
    script:
        "../scripts/align_recording.py"


rule figure_alignment:
    """Figure of a recording with the outlines of the phantom."""
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
    """Align all configured recordings of images."""
    input:
        recordings.alignments(),
    localrule: True
