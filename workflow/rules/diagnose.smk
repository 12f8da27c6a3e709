# Where recordings and the simulator differ, and which physics explains it: one job per recording and candidate effect.
from virtual_phantom.diagnosis.candidates import (
    candidates,
    check_accuracy,
    check_kinds,
)

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
            else candidates(settings, RECORDINGS[name].content["kind"])
        )
        for name, settings in DIAGNOSED.items()
    }
except InputError as error:
    sys.exit(f"Error: {error}")


localrules:
    diagnosis,


def diagnosis_inputs(wildcards):
    inputs = {"files": [str(path) for path in RECORDINGS[wildcards.recording].files]}
    settings = DIAGNOSED[wildcards.recording]
    if "object" in settings:
        inputs["mask"] = settings["object"]["mask"]
    elif "disc" not in settings:
        inputs["phantom"] = rules.phantom.output.fine
    return inputs


def physics_inputs(wildcards):
    """Where the physics is taken from, if it is not to be found here."""
    if "physics_from" not in DIAGNOSED[wildcards.recording]:
        return {}
    other = DIAGNOSED[wildcards.recording]["physics_from"]
    return {"physics": f"{RESULTS}/diagnosis/{other}/diagnosis.json"}


def same_material(wildcards):
    """Whether the object whose physics is taken was of the same single material."""
    settings = DIAGNOSED[wildcards.recording]
    both = settings, DIAGNOSED.get(settings.get("physics_from"), {})
    materials = [one.get("disc", one.get("object", {})).get("material") for one in both]
    return materials[0] is not None and materials[0] == materials[1]


def agreement_inputs(wildcards):
    """Regions of the study's phantom, if that was scanned."""
    if {"disc", "object"} & set(DIAGNOSED[wildcards.recording]):
        return {}
    return {
        "image": rules.phantom.output.image,
        "rois": rules.phantom.output.table,
        "masks": rules.phantom.output.rois,
    }


def diagnosis_megabytes(wildcards):
    """Rays of all repeats, path lengths at several samples per pixel, derivatives and numerical errors; of images, the
    realisations of noise, MB."""
    protocol = diagnosis_protocol(wildcards)
    scan = (
        protocol["scan"]
        if protocol
        else RECORDINGS[wildcards.recording].content["scan"]
    )
    views = protocol["projections"] if protocol else scan["views"]
    rays = views * scan["rows"] * scan["columns"] / 1e6
    return int(
        1500 + rays * (60 * DIAGNOSED[wildcards.recording]["samples"] ** 2 + 500)
    )


def diagnosis_protocol(wildcards):
    """The protocol that simulates a recording of images; None for projections."""
    name = DIAGNOSED[wildcards.recording].get("protocol")
    if name is None:
        return None
    config, settings = PLAN.config, PLAN.config["protocols"][name]
    geometry = PLAN.geometry_settings(PLAN.geometry_of(name))
    return {
        "scan": geometry["scan"],
        "grid": config["grid"],
        "projections": geometry["projections"],
        "algorithm": settings["algorithm"],
        "settings": config["reconstruction"][settings["algorithm"]],
        "engine": ENGINE,
    }


def diagnosis_gpu(wildcards):
    """Images are simulated by the study's engine, projections on the CPU."""
    return int(ENGINE == "astra_cuda" and diagnosis_protocol(wildcards) is not None)


def diagnosis_model(wildcards):
    """What was scanned and is simulated: all that the fits of a recording share."""
    return {
        "folder": str(RECORDINGS[wildcards.recording].folder),
        "settings": MODELLED[wildcards.recording],
        "mu_water_per_mm": PLAN.config["mu_water_per_mm"],
        "materials": PLAN.config["materials"],
        "seed": PLAN.config["seed"],
        "protocol": diagnosis_protocol(wildcards),
    }


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
