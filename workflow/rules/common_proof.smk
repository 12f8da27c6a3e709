"""Inputs and parameters of the rules of the proof."""


def parts_of(section, *keys):
    """What a job depends on of a section of the configuration: other keys do not run it again."""
    return {key: section[key] for key in keys if key in section}


def proof_cases(*paths):
    """Files of every case."""
    return [
        f"{RESULTS}/proof/{path}".format(case=case) for case in CASES for path in paths
    ]


def scanned_phantom(wildcards):
    """Files of the phantom of a case."""
    folder = f"{RESULTS}/proof/phantoms/{phantom_of(wildcards.case)}"
    return {
        "fine": f"{folder}/fine.nii.gz",
        "image": f"{folder}/image.nii.gz",
        "rois": f"{folder}/rois.csv",
    }


def known_phantom(wildcards):
    """What the diagnosis is told of it."""
    files = scanned_phantom(wildcards)
    return {
        "phantom": files["image"],
        "image": files["image"],
        "rois": files["rois"],
        "masks": os.path.join(os.path.dirname(files["rois"]), "rois"),
    }


def proof_model(folder, protocol):
    """As diagnosis_model, of a case's recording in a folder."""

    def model(wildcards):
        one, scan = OBJECTS[phantom_of(wildcards.case)], PROOF["scan"]
        kind = kind_of(wildcards.case, PROOF)
        views = dict(zip(PROTOCOLS, views_of(kind, PROOF)))[protocol]
        return {
            "folder": f"{RESULTS}/proof/{folder}/{wildcards.case}",
            "settings": {
                "samples": 2,
                "view_step": 1,
                "nominal_photons": PROOF[protocol]["photons"],
                "alignment": {},
            },
            "mu_water_per_mm": PLAN.config["mu_water_per_mm"],
            "materials": one.stated,
            "seed": PLAN.config["seed"],
            "protocol": (
                one.protocol(
                    scan["columns"],
                    scan["rows"],
                    views,
                    PROOF[protocol]["rotation_time_ms"],
                    "cpu",
                )
                if kind == "images"
                else None
            ),
        }

    return model


def tried(wildcards):
    """What a case is tried against."""
    return TRIED[kind_of(wildcards.case, PROOF)]
