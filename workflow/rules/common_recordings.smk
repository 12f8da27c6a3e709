"""Inputs and parameters of the rules that read recordings."""


def recording_megabytes(wildcards):
    """Memory to read a recording: an acquisition at a time, compressed on disk, and masks and copies beside it, MB."""
    largest = max(path.stat().st_size for path in RECORDINGS[wildcards.recording].files)
    return 1000 + 12 * largest // 10**6


def conditions_of(recording):
    """The columns that tell the conditions of a recording apart."""
    return RECORDINGS[recording].content.get("features", {}).get("conditions", [])


def recording_inputs(wildcards):
    """A recording's files, and for images the ROIs that were carried over to it."""
    document = RECORDINGS[wildcards.recording]
    inputs = {"files": [str(path) for path in document.files]}
    if document.content["kind"] == "images":
        folder = f"{RESULTS}/recordings/{wildcards.recording}"
        inputs |= {"rois": f"{folder}/rois.csv", "masks": f"{folder}/rois"}
    return inputs


def comparison_title(wildcards):
    """What is compared with what, for the head of the figure."""
    one = COMPARISONS[wildcards.comparison]
    conditions = ", ".join(f"{key} {value}" for key, value in one["where"].items())
    recorded = one["recording"] + (f" ({conditions})" if conditions else "")
    return f"{one['protocol']}, noise {one['noise']}, against {recorded}"


def comparison_of(key):
    """A parameter of a comparison; None if it is not given."""
    return lambda wildcards: COMPARISONS[wildcards.comparison].get(key)


def recorded_features(wildcards):
    recording = COMPARISONS[wildcards.comparison]["recording"]
    return f"{RESULTS}/recordings/{recording}/features.csv"


def compared_images(wildcards):
    return images(
        COMPARISONS[wildcards.comparison]["protocol"],
        COMPARISONS[wildcards.comparison]["noise"],
    )


def recorded_content(wildcards):
    return RECORDINGS[COMPARISONS[wildcards.comparison]["recording"]].content


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
