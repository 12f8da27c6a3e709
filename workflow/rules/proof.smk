# The blind test: an independent simulator conceals physics, the diagnosis works, and only then are the seals opened.
from virtual_phantom.diagnosis.candidates import candidates
from virtual_phantom.proof.conceal.objects import OBJECTS
from virtual_phantom.proof.conceal.suite import (
    PHANTOMS,
    PROTOCOLS,
    cases,
    check_recordings,
    check_tried,
    kind_of,
    phantom_of,
    views_of,
)

PROOF = PLAN.config["proof"]
# Callbacks that XCIST imports by name.
HOOKS = sorted(
    shipped(os.path.join(LIBRARY, "virtual_phantom/proof/conceal/hooks", name))
    for name in os.listdir(os.path.join(LIBRARY, "virtual_phantom/proof/conceal/hooks"))
    if name.endswith(".py")
)
try:
    CASES = cases(PROOF)
    check_tried(PROOF)
    check_recordings(PROOF["recordings"], DIAGNOSED)
except InputError as error:
    sys.exit(f"Error: {error}")


wildcard_constraints:
    case="case_[0-9]+",
    phantom="|".join(PHANTOMS),


# By what cases are drawn, and by what they are scanned.
DRAWN = (
    parts_of(PROOF, "seed", "effects", "strengths", "none", "pairs", "unknown")
    | {"images": parts_of(PROOF["images"], "strengths", "effects")}
    | {"scan": parts_of(PROOF["scan"], "rows")}
)
SCANNED = parts_of(PROOF, "seed", "scan", "held_out_protocol")


rule proof_phantom:
    """What is scanned, and, on voxels twice as large, what the diagnosis is told of it."""
    input:
        layout=lambda wildcards: resource(OBJECTS[wildcards.phantom].layout),
        code=code("proof_phantom.py"),
    output:
        image=f"{RESULTS}/proof/phantoms/{{phantom}}/image.nii.gz",
        fine=f"{RESULTS}/proof/phantoms/{{phantom}}/fine.nii.gz",
        table=f"{RESULTS}/proof/phantoms/{{phantom}}/rois.csv",
        rois=directory(f"{RESULTS}/proof/phantoms/{{phantom}}/rois"),
    log:
        f"{RESULTS}/logs/proof/phantom_{{phantom}}.log",
    resources:
        mem_mb=2000,
        runtime=30,
    params:
        scan=PROOF["scan"],
        seed=PLAN.config["seed"],
    script:
        "../scripts/proof_phantom.py"


PHOTONS = PROOF["scan"]["photons"]
try:
    TRIED = {
        "projections": candidates({"nominal_photons": PHOTONS}),
        "images": candidates(
            {"nominal_photons": PHOTONS, "effects": PROOF["images"]["tried"]}, "images"
        ),
    }
except InputError as error:
    sys.exit(f"Error: {error}".replace("diagnosis.effects", "proof.images.tried"))


rule proof_seal:
    """What is concealed in every case, drawn and sealed; the seals are published before anything is scanned."""
    input:
        code=code("seal_proof.py"),
    output:
        sealed=proof_cases("sealed/{case}.json"),
        seals=f"{RESULTS}/proof/seals.json",
    log:
        f"{RESULTS}/logs/proof/seal.log",
    localrule: True
    params:
        settings=DRAWN,
    script:
        "../scripts/seal_proof.py"


rule proof_scan:
    """The recordings of one case."""
    input:
        sealed=f"{RESULTS}/proof/sealed/{{case}}.json",
        seals=rules.proof_seal.output.seals,
        fine=lambda wildcards: scanned_phantom(wildcards)["fine"],
        code=code("conceal.py"),
        hooks=HOOKS,
    output:
        recording=directory(f"{RESULTS}/proof/recordings/{{case}}"),
        other=directory(f"{RESULTS}/proof/held_out_protocol/{{case}}"),
    log:
        f"{RESULTS}/logs/proof/scan_{{case}}.log",
    benchmark:
        f"{RESULTS}/logs/proof/scan_{{case}}.benchmark.tsv"
    resources:
        mem_mb=2500,
        runtime=60,
    params:
        settings=lambda wildcards: (
            SCANNED | {"images": parts_of(PROOF["images"], "views_times")}
            if kind_of(wildcards.case, PROOF) == "images"
            else SCANNED
        ),
        mu_water_per_mm=PLAN.config["mu_water_per_mm"],
    script:
        "../scripts/conceal.py"


rule proof_diagnosis:
    """As the rules of diagnose.smk, in one job: it sees the recording and the known phantom, nothing else."""
    input:
        unpack(known_phantom),
        recording=rules.proof_scan.output.recording,
        effects=lambda wildcards: effect_code(*tried(wildcards)),
        code=code("diagnose.py"),
    output:
        diagnosis=f"{RESULTS}/proof/diagnosis/{{case}}/diagnosis.json",
        physics=f"{RESULTS}/proof/diagnosis/{{case}}/physics.yaml",
        report=f"{RESULTS}/proof/diagnosis/{{case}}/report.html",
        maps=directory(f"{RESULTS}/proof/diagnosis/{{case}}/maps"),
    log:
        f"{RESULTS}/logs/proof/diagnosis_{{case}}.log",
    benchmark:
        f"{RESULTS}/logs/proof/diagnosis_{{case}}.benchmark.tsv"
    resources:
        mem_mb=2500,
        runtime=60,
    params:
        model=proof_model("recordings", "scan"),
        effects=tried,
        same_material=True,
        accuracy=PLAN.config["diagnosis"]["model_accuracy"],
    script:
        "../scripts/diagnose.py"


rule proof_elsewhere:
    """The physics found, held against the case's scan by another protocol."""
    input:
        unpack(known_phantom),
        recording=rules.proof_scan.output.other,
        physics=rules.proof_diagnosis.output.diagnosis,
        effects=lambda wildcards: effect_code(*tried(wildcards)),
        code=code("agreement_elsewhere.py"),
    output:
        f"{RESULTS}/proof/diagnosis/{{case}}/held_out_protocol.json",
    log:
        f"{RESULTS}/logs/proof/elsewhere_{{case}}.log",
    benchmark:
        f"{RESULTS}/logs/proof/elsewhere_{{case}}.benchmark.tsv"
    resources:
        mem_mb=2500,
        runtime=30,
    params:
        model=proof_model("held_out_protocol", "held_out_protocol"),
    script:
        "../scripts/agreement_elsewhere.py"


rule proof_verdicts:
    """Every diagnosis, and how it did by another protocol, bound by hashes before any seal is opened."""
    input:
        diagnoses=proof_cases("diagnosis/{case}/diagnosis.json"),
        others=proof_cases("diagnosis/{case}/held_out_protocol.json"),
        code=code("proof_verdicts.py"),
    output:
        proof_cases("verdicts/{case}.json"),
    log:
        f"{RESULTS}/logs/proof/verdicts.log",
    localrule: True
    script:
        "../scripts/proof_verdicts.py"


rule proof_score:
    """The seals opened, verdicts and truths checked against their hashes, and all of it scored."""
    input:
        sealed=rules.proof_seal.output.sealed,
        seals=rules.proof_seal.output.seals,
        verdicts=rules.proof_verdicts.output,
        diagnoses=proof_cases("diagnosis/{case}/diagnosis.json"),
        others=proof_cases("diagnosis/{case}/held_out_protocol.json"),
        maps=proof_cases("diagnosis/{case}/maps"),
        times=[
            f"{RESULTS}/logs/proof/{job}_{case}.benchmark.tsv"
            for job in ("scan", "diagnosis", "elsewhere")
            for case in CASES
        ],
        real=expand(
            f"{RESULTS}/diagnosis/{{recording}}/diagnosis.json",
            recording=PROOF["recordings"],
        ),
        real_maps=expand(
            f"{RESULTS}/diagnosis/{{recording}}/maps", recording=PROOF["recordings"]
        ),
        record=PROOF_RECORD,
        code=code("score_proof.py"),
    output:
        score=f"{RESULTS}/proof/score.json",
        page=report(
            f"{RESULTS}/proof/score.html",
            caption="../report/proof.rst",
            category="Proof",
        ),
        confusion_png=f"{RESULTS}/proof/figures/confusion.png",
        confusion_pdf=f"{RESULTS}/proof/figures/confusion.pdf",
        example_png=f"{RESULTS}/proof/figures/before_after.png",
        example_pdf=f"{RESULTS}/proof/figures/before_after.pdf",
    log:
        f"{RESULTS}/logs/proof/score.log",
    resources:
        mem_mb=2000,
        runtime=20,
    params:
        suite=PROOF,
    script:
        "../scripts/score_proof.py"


rule proof:
    """The blind test."""
    input:
        rules.proof_score.output,
    localrule: True
