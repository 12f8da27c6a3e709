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


localrules:
    recordings,


def recording_megabytes(wildcards):
    """Memory to read a recording: an acquisition at a time, compressed on disk, and masks and copies beside it, MB."""
    largest = max(path.stat().st_size for path in RECORDINGS[wildcards.recording].files)
    return 1000 + 12 * largest // 10**6


rule recording_summary:
    """Read and check one recording; what was found, what is known of the scan, what is missing."""
    input:
        files=lambda wildcards: [
            str(path) for path in RECORDINGS[wildcards.recording].files
        ],
        schema="workflow/schemas/recording.schema.yaml",
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
    resources:
        mem_mb=500,
        runtime=5,
    params:
        names=list(RECORDINGS),
    script:
        "../scripts/recordings.py"
