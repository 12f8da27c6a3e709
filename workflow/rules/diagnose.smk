# Where recordings and the simulator differ, and which physics explains it: one job per recording and candidate effect.
from virtual_phantom.diagnosis.candidates import (
    candidates,
    check_accuracy,
    check_kinds,
)
from virtual_phantom.recordings.scan import timed

# How often the intervals that a diagnosis states held the truth in the proof.
PROOF_RECORD = resource("proof_record.yaml")
DIAGNOSED = PLAN.config["diagnosis"]["recordings"]
# What every fit of a recording depends on: another list of effects redoes none.
MODELLED = {
    name: {
        key: value
        for key, value in settings.items()
        if key not in ("effects", "physics_from")
    }
    for name, settings in DIAGNOSED.items()
}
try:
    check_kinds(DIAGNOSED, RECORDINGS)
    check_accuracy(PLAN.config["diagnosis"]["model_accuracy"])
    CANDIDATES = {
        name: (
            []
            if "physics_from" in settings
            else candidates(
                settings,
                RECORDINGS[name].content["kind"],
                timed(RECORDINGS[name].content),
            )
        )
        for name, settings in DIAGNOSED.items()
    }
except InputError as error:
    sys.exit(f"Error: {error}")


rule diagnosis_alignment:
    """The simulator with nothing but alignment: what every effect is held against."""
    input:
        unpack(diagnosis_inputs),
        code=code("diagnose_candidate.py"),
    output:
        f"{RESULTS}/diagnosis/{{recording}}/alignment.json",
    log:
        f"{RESULTS}/logs/diagnosis/{{recording}}/alignment.log",
    resources:
        mem_mb=diagnosis_megabytes,
        runtime=60,
        gpu=diagnosis_gpu,
    params:
        model=diagnosis_model,
        effect=None,
    script:
        "../scripts/diagnose_candidate.py"


use rule diagnosis_alignment as diagnosis_effect with:
    input:
        unpack(diagnosis_inputs),
        baseline=rules.diagnosis_alignment.output[0],
        effect=lambda wildcards: effect_code(wildcards.effect),
        code=code("diagnose_candidate.py"),
    output:
        f"{RESULTS}/diagnosis/{{recording}}/effects/{{effect}}.json",
    log:
        f"{RESULTS}/logs/diagnosis/{{recording}}/{{effect}}.log",
    params:
        model=diagnosis_model,
        effect=lambda wildcards: wildcards.effect,


rule diagnose:
    """Verdict, physics and report of one recording."""
    input:
        unpack(diagnosis_inputs),
        unpack(agreement_inputs),
        unpack(physics_inputs),
        baseline=rules.diagnosis_alignment.output[0],
        candidates=lambda wildcards: [
            f"{RESULTS}/diagnosis/{wildcards.recording}/effects/{effect}.json"
            for effect in CANDIDATES[wildcards.recording]
        ],
        effects=lambda wildcards: effect_code(*CANDIDATES[wildcards.recording]),
        record=PROOF_RECORD,
        code=code("diagnose.py"),
    output:
        diagnosis=f"{RESULTS}/diagnosis/{{recording}}/diagnosis.json",
        physics=f"{RESULTS}/diagnosis/{{recording}}/physics.yaml",
        report=report(
            f"{RESULTS}/diagnosis/{{recording}}/report.html",
            caption="../report/diagnosis.rst",
            category="Diagnosis",
            labels={"recording": "{recording}"},
        ),
        maps=directory(f"{RESULTS}/diagnosis/{{recording}}/maps"),
    log:
        f"{RESULTS}/logs/diagnosis/{{recording}}/diagnose.log",
    wildcard_constraints:
        recording="|".join(DIAGNOSED) or "none",
    threads: 2
    resources:
        mem_mb=diagnosis_megabytes,
        runtime=120,
        gpu=diagnosis_gpu,
    params:
        model=diagnosis_model,
        effects=lambda wildcards: CANDIDATES[wildcards.recording],
        same_material=same_material,
        accuracy=PLAN.config["diagnosis"]["model_accuracy"],
    script:
        "../scripts/diagnose.py"


rule diagnosis:
    """Every recording and comparison under diagnosis."""
    input:
        [
            f"{RESULTS}/diagnosis/{name}/diagnosis.json"
            for name in [*DIAGNOSED, *DIAGNOSED_COMPARISONS]
        ],
    localrule: True
