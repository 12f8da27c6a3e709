# Planning of the next measurement, for recordings and scanners under diagnosis.
diagnosis = context.diagnosis


rule next_of_recording:
    """Rank further recordings by how well they would resolve the ambiguities of one recording."""
    input:
        unpack(lambda wildcards: diagnosis.inputs(wildcards.recording)),
        diagnosis=results("diagnosis/{recording}/diagnosis.json"),
    output:
        directory(results("diagnosis/{recording}/next_measurement")),
    log:
        results("logs/diagnosis/{recording}/next_measurement.log"),
    wildcard_constraints:
        recording="|".join(diagnosis.settings) or "none",
    resources:
        mem_mb=lambda wildcards: diagnosis.megabytes(wildcards.recording),
        runtime=120,
    params:
        what=lambda wildcards: wildcards.recording,
        models=lambda wildcards: {
            wildcards.recording: to_mapping(diagnosis.model(wildcards.recording))
        },
        effects=lambda wildcards: diagnosis.candidates[wildcards.recording],
        code=lambda wildcards: code(
            "next_measurement.py", diagnosis.in_fits(wildcards.recording)
        ),
    script:
        "../scripts/next_measurement.py"


use rule next_of_recording as next_of_scanner with:
    input:
        unpack(lambda wildcards: diagnosis.scanner_inputs(wildcards.scanner)),
        diagnosis=results("diagnosis/scanners/{scanner}/scanner.json"),
    output:
        directory(results("diagnosis/scanners/{scanner}/next_measurement")),
    log:
        results("logs/diagnosis/scanners/{scanner}/next_measurement.log"),
    wildcard_constraints:
        scanner="|".join(diagnosis.scanners) or "none",
    resources:
        mem_mb=lambda wildcards: sum(
            diagnosis.megabytes(name)
            for name in diagnosis.scanners[wildcards.scanner].recordings
        ),
        runtime=300,
    params:
        what=lambda wildcards: wildcards.scanner,
        models=lambda wildcards: to_mapping(
            diagnosis.models(wildcards.scanner, judged=False)
        ),
        effects=lambda wildcards: diagnosis.shared_candidates(wildcards.scanner),
        protocols=lambda wildcards: diagnosis.scanners[wildcards.scanner].protocols,
        code=lambda wildcards: code(
            "next_measurement.py",
            diagnosis.in_fits(*diagnosis.scanners[wildcards.scanner].recordings),
        ),


rule next_measurement:
    """Plan the next measurement for all recordings of projections and scanners under diagnosis."""
    input:
        diagnosis.next_measurements(),
    localrule: True
