from virtual_phantom.recordings.document import read_document

try:
    RECORDINGS = {
        name: read_document(folder)
        for name, folder in PLAN.config["recordings"].items()
    }
except InputError as error:
    sys.exit(f"Error: {error}")


wildcard_constraints:
    recording="[A-Za-z0-9_]+",


rule recording_summary:
    """Read and check one recording; what was found, what is known of the scan, what is missing."""
    input:
        files=lambda wildcards: [
            str(path) for path in RECORDINGS[wildcards.recording].files
        ],
        schema=shipped(SCHEMAS / "recording.schema.yaml"),
        code=code("recording_summary.py"),
    output:
        f"{RESULTS}/recordings/{{recording}}/summary.json",
    log:
        f"{RESULTS}/logs/recording_summary/{{recording}}.log",
    resources:
        mem_mb=recording_megabytes,
        runtime=30,
    params:
        folder=lambda wildcards: str(RECORDINGS[wildcards.recording].folder),
    script:
        "../scripts/recording_summary.py"


rule figure_recording:
    """What a recording of projections or images looks like."""
    input:
        files=lambda wildcards: [
            str(path) for path in RECORDINGS[wildcards.recording].files
        ],
        code=code("figures/recording.py"),
    output:
        png=report(
            f"{RESULTS}/figures/recording_{{recording}}.png",
            caption="../report/recording.rst",
            category="Recordings",
            labels={"figure": "recording {recording}"},
        ),
        pdf=f"{RESULTS}/figures/recording_{{recording}}.pdf",
    log:
        f"{RESULTS}/logs/figure_recording/{{recording}}.log",
    resources:
        mem_mb=recording_megabytes,
        runtime=30,
    params:
        folder=lambda wildcards: str(RECORDINGS[wildcards.recording].folder),
    script:
        "../scripts/figures/recording.py"


rule recordings:
    """All configured recordings in one table, printed."""
    input:
        summaries=[f"{RESULTS}/recordings/{name}/summary.json" for name in RECORDINGS],
        figures=[
            figure(f"recording_{name}")
            for name, document in RECORDINGS.items()
            if document.content["kind"] != "features"
        ],
        code=code("recordings.py"),
    output:
        f"{RESULTS}/recordings/recordings.csv",
    log:
        f"{RESULTS}/logs/recordings.log",
    localrule: True
    resources:
        mem_mb=500,
        runtime=5,
    params:
        names=list(RECORDINGS),
    script:
        "../scripts/recordings.py"


ALIGNED = [
    name
    for name, document in RECORDINGS.items()
    if document.content["kind"] == "images"
]


rule align_recording:
    """Where the phantom lies in a recording of images, and its ROIs on the recording's own grid."""
    input:
        files=lambda wildcards: [
            str(path) for path in RECORDINGS[wildcards.recording].files
        ],
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("align_recording.py"),
    output:
        alignment=f"{RESULTS}/recordings/{{recording}}/alignment.json",
        image=f"{RESULTS}/recordings/{{recording}}/image.nii.gz",
        table=f"{RESULTS}/recordings/{{recording}}/rois.csv",
        rois=directory(f"{RESULTS}/recordings/{{recording}}/rois"),
    log:
        f"{RESULTS}/logs/align_recording/{{recording}}.log",
    resources:
        # A few copies of an image and its mask, compressed on disk, and three levels of the phantom.
        mem_mb=lambda wildcards: megabytes(volumes=12)
        + 40
        * max(path.stat().st_size for path in RECORDINGS[wildcards.recording].files)
        // 10**6,
        runtime=120,
    params:
        folder=lambda wildcards: str(RECORDINGS[wildcards.recording].folder),
        phantom=PLAN.config["phantom"],
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
        code=code("figures/alignment.py"),
    output:
        png=report(
            f"{RESULTS}/figures/alignment_{{recording}}.png",
            caption="../report/alignment.rst",
            category="Recordings",
            labels={"figure": "alignment of {recording}"},
        ),
        pdf=f"{RESULTS}/figures/alignment_{{recording}}.pdf",
    log:
        f"{RESULTS}/logs/figure_alignment/{{recording}}.log",
    resources:
        **FIGURE_RESOURCES,
    script:
        "../scripts/figures/alignment.py"


rule alignment:
    """All configured recordings of images, aligned."""
    input:
        [
            [
                f"{RESULTS}/recordings/{name}/alignment.json",
                *figure(f"alignment_{name}"),
            ]
            for name in ALIGNED
        ],
    localrule: True
