# Blind validation: an independent simulator hides physics, the diagnosis runs, and the seals are opened afterwards.
proof = context.proof


rule proof_seal:
    """Draw and seal the hidden physics of each case; publish the seals and register the run before any scan."""
    output:
        sealed=proof.all("sealed"),
        seals=results("proof/seals.json"),
        registration=results("proof/registration.json"),
    log:
        results("logs/proof/seal.log"),
    localrule: True
    params:
        settings=proof.hiding,
        registered=context.benchmark.registered,
        runs=context.benchmark.runs_file,
        code=code("seal_proof.py"),
    script:
        "../scripts/seal_proof.py"


rule proof_scan:
    """The recordings of one case, and its stated object, which does not depend on the seal."""
    input:
        sealed=results("proof/sealed/{case}.json"),
        seals=rules.proof_seal.output.seals,
    output:
        stated=directory(results("proof/objects/{case}")),
        recording=directory(results("proof/recordings/{case}")),
        other=directory(results("proof/held_out_protocol/{case}")),
    log:
        results("logs/proof/scan_{case}.log"),
    benchmark:
        results("logs/proof/scan_{case}.benchmark.tsv")
    resources:
        mem_mb=2500,
        runtime=60,
    params:
        settings=lambda wildcards: proof.scan_settings(wildcards.case),
        mu_water_per_mm=context.study.mu_water_per_mm,
        code=code("scan_proof.py", hooks=True),
    script:
        "../scripts/scan_proof.py"


rule proof_diagnosis:
    """Diagnose one case from its recording, the stated object and the declared deviations alone."""
    input:
        stated=rules.proof_scan.output.stated,
        recording=rules.proof_scan.output.recording,
    output:
        diagnosis=results("proof/diagnosis/{case}/diagnosis.json"),
        physics=results("proof/diagnosis/{case}/physics.yaml"),
        report=results("proof/diagnosis/{case}/report.html"),
        maps=directory(results("proof/diagnosis/{case}/maps")),
    log:
        results("logs/proof/diagnosis_{case}.log"),
    benchmark:
        results("logs/proof/diagnosis_{case}.benchmark.tsv")
    resources:
        mem_mb=3500,
        runtime=60,
    params:
        model=lambda wildcards: to_mapping(proof.model(wildcards.case)),
        phantom=lambda wildcards: proof.object_file(wildcards.case, "phantom"),
        image=lambda wildcards: proof.object_file(wildcards.case, "image"),
        rois=lambda wildcards: proof.object_file(wildcards.case, "rois"),
        effects=lambda wildcards: proof.tried_on(wildcards.case),
        same_material=True,
        accuracy=context.study.diagnosis.model_accuracy,
        # As for users: some scans have deviations that are too small to be relevant, and they are not declared.
        matters=context.study.diagnosis.matters,
        code=lambda wildcards: code("diagnose.py", proof.tried_on(wildcards.case)),
    script:
        "../scripts/diagnose.py"


rule proof_elsewhere:
    """Compare the physics found with a scan by another protocol, for a case with one hidden effect."""
    input:
        stated=rules.proof_scan.output.stated,
        recording=rules.proof_scan.output.other,
        physics=rules.proof_diagnosis.output.diagnosis,
    output:
        results("proof/diagnosis/{case}/held_out_protocol.json"),
    log:
        results("logs/proof/elsewhere_{case}.log"),
    benchmark:
        results("logs/proof/elsewhere_{case}.benchmark.tsv")
    resources:
        mem_mb=2500,
        runtime=30,
    params:
        model=lambda wildcards: to_mapping(proof.held_out_model(wildcards.case)),
        phantom=lambda wildcards: proof.object_file(wildcards.case, "phantom"),
        image=lambda wildcards: proof.object_file(wildcards.case, "image"),
        rois=lambda wildcards: proof.object_file(wildcards.case, "rois"),
        code=lambda wildcards: code(
            "agreement_other_protocol.py", proof.tried_on(wildcards.case)
        ),
    script:
        "../scripts/agreement_other_protocol.py"


rule proof_verdicts:
    """The verdict document of each diagnosis, with hashes of the diagnosis, before any seal is opened."""
    input:
        diagnoses=proof.all("proof_diagnosis"),
        others=proof.compared(),
    output:
        proof.all("verdict"),
    log:
        results("logs/proof/verdicts.log"),
    localrule: True
    params:
        code=code("proof_verdicts.py"),
    script:
        "../scripts/proof_verdicts.py"


rule proof_score:
    """Open the seals, check verdicts and truths against their hashes, and compute the score."""
    input:
        sealed=rules.proof_seal.output.sealed,
        seals=rules.proof_seal.output.seals,
        verdicts=rules.proof_verdicts.output,
        diagnoses=proof.all("proof_diagnosis"),
        others=proof.compared(),
        maps=proof.all("proof_maps"),
        times=proof.times(),
        real=proof.real("diagnosis"),
        real_maps=proof.real("diagnosis_maps"),
        registration=rules.proof_seal.output.registration,
    output:
        score=results("proof/score.json"),
        page=reported("proof/score.html"),
        confusion_png=results("proof/figures/confusion.png"),
        confusion_pdf=results("proof/figures/confusion.pdf"),
        example_png=results("proof/figures/before_after.png"),
        example_pdf=results("proof/figures/before_after.pdf"),
    log:
        results("logs/proof/score.log"),
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        suite=to_mapping(proof.settings),
        registered=context.benchmark.registered,
        runs=context.benchmark.runs_file,
        code=code("score_proof.py"),
    script:
        "../scripts/score_proof.py"


rule proof:
    """The blind validation."""
    input:
        rules.proof_score.output,
    localrule: True


rule proof_suite:
    """Describe for other programs what the diagnosis of each case is given."""
    output:
        results("proof/suite.json"),
    log:
        results("logs/proof/suite.log"),
    localrule: True
    params:
        cases=lambda wildcards: context.benchmark.given(),
        code=code("proof_suite.py"),
    script:
        "../scripts/proof_suite.py"


rule hide:
    """A suite of the blind validation for any program: recordings, known objects and seals, without diagnoses."""
    input:
        rules.proof_seal.output,
        rules.proof_suite.output,
        proof.all("proof_object"),
        proof.all("proof_recording"),
        proof.all("proof_held_out"),
    localrule: True


rule score_verdicts:
    """Open the seals of a suite and score the verdicts of the key `verdicts`, or of the diagnosis."""
    input:
        sealed=rules.proof_seal.output.sealed,
        seals=rules.proof_seal.output.seals,
        verdicts=context.benchmark.verdict_files(),
    output:
        hashes=results("proof/programs/{program}/hashes.json"),
        score=results("proof/programs/{program}/score.json"),
        table=results("proof/programs/{program}/score.md"),
    log:
        results("logs/proof/score_{program}.log"),
    localrule: True
    params:
        code=code("score_verdicts.py"),
    script:
        "../scripts/score_verdicts.py"


rule score:
    """The score of the verdicts in the folder that the key verdicts names."""
    input:
        results(f"proof/programs/{context.benchmark.program}/hashes.json"),
        results(f"proof/programs/{context.benchmark.program}/score.json"),
        results(f"proof/programs/{context.benchmark.program}/score.md"),
    localrule: True


onerror:
    context.benchmark.log_failure(log)
