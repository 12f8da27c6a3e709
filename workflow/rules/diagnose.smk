# Diagnosis: where recordings and simulation differ, and which missing physics explains it. One job per recording.
diagnosis = context.diagnosis
AT_MOST = workflow.resource_settings.cores  # None on a cluster that sets no --cores


rule diagnose:
    """Verdict, physics and report of one recording."""
    input:
        unpack(lambda wildcards: diagnosis.inputs(wildcards.recording)),
        unpack(lambda wildcards: diagnosis.regions(wildcards.recording)),
        unpack(lambda wildcards: diagnosis.physics(wildcards.recording)),
        # Coverage of the intervals in the blind validation.
        record=resource("proof_record.yaml"),
    output:
        diagnosis=results("diagnosis/{recording}/diagnosis.json"),
        physics=results("diagnosis/{recording}/physics.yaml"),
        report=reported("diagnosis/{recording}/report.html"),
        maps=directory(results("diagnosis/{recording}/maps")),
        setup=results("diagnosis/{recording}/setup.json"),
    log:
        results("logs/diagnosis/{recording}/diagnose.log"),
    wildcard_constraints:
        recording="|".join(diagnosis.settings) or "none",
    threads: lambda made: diagnosis.processes(made.recording, AT_MOST)
    resources:
        mem_mb=lambda wildcards, threads: diagnosis.megabytes(
            wildcards.recording, threads
        ),
        runtime=lambda wildcards, threads, attempt: attempt
        * diagnosis.minutes(wildcards.recording, threads),
        gpu=lambda wildcards: diagnosis.gpus(wildcards.recording),
    params:
        model=lambda wildcards: to_mapping(diagnosis.model(wildcards.recording)),
        # Cached fits. They are not an output, since Snakemake would delete them before an interrupted job continues.
        cache_folder=lambda wildcards: diagnosis.fit_cache(wildcards.recording),
        effects=lambda wildcards: diagnosis.candidates[wildcards.recording],
        same_material=lambda wildcards: diagnosis.same_material(wildcards.recording),
        accuracy=context.study.diagnosis.model_accuracy,
        matters=context.study.diagnosis.matters,
        code=lambda wildcards: code(
            "diagnose.py", diagnosis.in_fits(wildcards.recording)
        ),
    script:
        "../scripts/diagnose.py"


rule diagnose_scanner:
    """Physics that the recordings of a scanner share, tested on recordings that were not fitted."""
    input:
        unpack(lambda wildcards: diagnosis.scanner_inputs(wildcards.scanner)),
    output:
        diagnosis=results("diagnosis/scanners/{scanner}/scanner.json"),
        physics=results("diagnosis/scanners/{scanner}/physics.yaml"),
        report=reported("diagnosis/scanners/{scanner}/report.html"),
    log:
        results("logs/diagnosis/scanners/{scanner}/diagnose.log"),
    wildcard_constraints:
        scanner="|".join(diagnosis.scanners) or "none",
    threads: 2
    resources:
        mem_mb=lambda wildcards: sum(
            diagnosis.megabytes(name)
            for name in diagnosis.scanners[wildcards.scanner].recordings
        ),
        runtime=600,
    params:
        models=lambda wildcards: to_mapping(diagnosis.models(wildcards.scanner)),
        effects=lambda wildcards: diagnosis.shared_candidates(wildcards.scanner),
        accuracy=context.study.diagnosis.model_accuracy,
        protocols=lambda wildcards: diagnosis.scanners[wildcards.scanner].protocols,
        test_recordings=lambda wildcards: diagnosis.scanners[
            wildcards.scanner
        ].test_recordings,
        code=lambda wildcards: code(
            "diagnose_scanner.py",
            diagnosis.in_fits(*diagnosis.scanners[wildcards.scanner].recordings),
        ),
    script:
        "../scripts/diagnose_scanner.py"


if context.study.diagnosis.fail_on:

    rule diagnosis:
        """Diagnose all recordings and comparisons; exit code 1 if a verdict is in diagnosis.fail_on."""
        input:
            diagnosis.all(),
        log:
            results("logs/diagnosis/verdicts.log"),
        localrule: True
        params:
            fail_on=context.study.diagnosis.fail_on,
        script:
            "../scripts/verdicts.py"

else:

    rule diagnosis:
        """Diagnose all recordings and comparisons."""
        input:
            diagnosis.all(),
        localrule: True
