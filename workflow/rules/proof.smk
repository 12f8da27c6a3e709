# The blind test: an independent simulator conceals physics, the diagnosis works, and only then are the seals opened.
rule proof_phantom:
    """What is scanned, and, on voxels twice as large, what the diagnosis is told of it."""
    input:
        layout=lambda wildcards: context.proof.layout(wildcards.phantom),
        code=context.code("proof_phantom.py"),
    output:
        image=context.file("proof_image"),
        fine=context.file("proof_fine"),
        table=context.file("proof_table"),
        rois=directory(context.file("proof_rois")),
    log:
        context.log("proof/phantom_{phantom}"),
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        scan=context.proof.settings["scan"],
        seed=context.config["seed"],
    script:
        "../scripts/proof_phantom.py"


rule proof_seal:
    """What is concealed in every case, drawn and sealed; the seals are published before anything is scanned."""
    input:
        code=context.code("seal_proof.py"),
    output:
        sealed=context.proof.all("sealed"),
        seals=context.file("seals"),
    log:
        context.log("proof/seal"),
    localrule: True
    params:
        settings=context.proof.drawn,
    script:
        "../scripts/seal_proof.py"


rule proof_scan:
    """The recordings of one case."""
    input:
        sealed=context.file("sealed"),
        seals=rules.proof_seal.output.seals,
        fine=lambda wildcards: context.proof.fine_phantom(wildcards.case),
        code=context.code("conceal.py"),
        hooks=context.hook_code(),
    output:
        recording=directory(context.file("proof_recording")),
        other=directory(context.file("proof_held_out")),
    log:
        context.log("proof/scan_{case}"),
    benchmark:
        context.benchmark("proof/scan_{case}")
    resources:
        mem_mb=2500,
        runtime=60,
    params:
        settings=lambda wildcards: context.proof.scanned(wildcards.case),
        mu_water_per_mm=context.config["mu_water_per_mm"],
    script:
        "../scripts/conceal.py"


rule proof_diagnosis:
    """As the rules of diagnose.smk, in one job: it sees the recording and the known phantom, nothing else."""
    input:
        unpack(lambda wildcards: context.proof.known_phantom(wildcards.case)),
        recording=rules.proof_scan.output.recording,
        effects=lambda wildcards: context.effect_code(
            *context.proof.tried_on(wildcards.case)
        ),
        code=context.code("diagnose.py"),
    output:
        diagnosis=context.file("proof_diagnosis"),
        physics=context.file("proof_physics"),
        report=context.file("proof_report"),
        maps=directory(context.file("proof_maps")),
    log:
        context.log("proof/diagnosis_{case}"),
    benchmark:
        context.benchmark("proof/diagnosis_{case}")
    resources:
        mem_mb=2500,
        runtime=60,
    params:
        model=lambda wildcards: context.proof.model(wildcards.case),
        effects=lambda wildcards: context.proof.tried_on(wildcards.case),
        same_material=True,
        accuracy=context.diagnosis.accuracy,
        # The proof asks for every effect that is there, however little it changes in images.
        matters=None,
    script:
        "../scripts/diagnose.py"


rule proof_elsewhere:
    """The physics found, held against the case's scan by another protocol."""
    input:
        unpack(lambda wildcards: context.proof.known_phantom(wildcards.case)),
        recording=rules.proof_scan.output.other,
        physics=rules.proof_diagnosis.output.diagnosis,
        effects=lambda wildcards: context.effect_code(
            *context.proof.tried_on(wildcards.case)
        ),
        code=context.code("agreement_elsewhere.py"),
    output:
        context.file("proof_elsewhere"),
    log:
        context.log("proof/elsewhere_{case}"),
    benchmark:
        context.benchmark("proof/elsewhere_{case}")
    resources:
        mem_mb=2500,
        runtime=30,
    params:
        model=lambda wildcards: context.proof.held_out_model(wildcards.case),
    script:
        "../scripts/agreement_elsewhere.py"


rule proof_verdicts:
    """Every diagnosis, and how it did by another protocol, bound by hashes before any seal is opened."""
    input:
        diagnoses=context.proof.all("proof_diagnosis"),
        others=context.proof.all("proof_elsewhere"),
        code=context.code("proof_verdicts.py"),
    output:
        context.proof.all("verdict"),
    log:
        context.log("proof/verdicts"),
    localrule: True
    script:
        "../scripts/proof_verdicts.py"


rule proof_score:
    """The seals opened, verdicts and truths checked against their hashes, and all of it scored."""
    input:
        sealed=rules.proof_seal.output.sealed,
        seals=rules.proof_seal.output.seals,
        verdicts=rules.proof_verdicts.output,
        diagnoses=context.proof.all("proof_diagnosis"),
        others=context.proof.all("proof_elsewhere"),
        maps=context.proof.all("proof_maps"),
        times=context.proof.times(),
        real=context.proof.real("diagnosis"),
        real_maps=context.proof.real("diagnosis_maps"),
        record=context.resource("proof_record.yaml"),
        code=context.code("score_proof.py"),
    output:
        score=context.file("score"),
        page=report(context.file("score_page"), **context.reported("score_page")),
        confusion_png=context.file("confusion", ".png"),
        confusion_pdf=context.file("confusion", ".pdf"),
        example_png=context.file("before_after", ".png"),
        example_pdf=context.file("before_after", ".pdf"),
    log:
        context.log("proof/score"),
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        suite=context.proof.settings,
    script:
        "../scripts/score_proof.py"


rule proof:
    """The blind test."""
    input:
        rules.proof_score.output,
    localrule: True
