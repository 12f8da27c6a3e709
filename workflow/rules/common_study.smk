"""Inputs, groups and titles of the rules of the study."""

from functools import cache


def present(*paths):
    """The files at these paths, those in folders too. What is missing is left to the script, which says so in a line."""
    return [
        str(file)
        for path in paths
        if path and os.path.exists(path)
        for file in files_of(path)
    ]


def phantom_sources():
    """Every file that the phantom is made from; of those that a rule fetches, what is not here yet too."""
    fetched = [file.path for file in PUBLISHED]
    return [*dict.fromkeys(fetched + present(*phantom_files()))]


def acquisition(noise, seed):
    """What tells the acquisitions of one geometry apart."""
    level = PLAN.config["noise"]["levels"][noise].get("A")
    return {"noise": noise, "noise_level": level, "seed": int(seed)}


def level_files(*levels):
    """The files of those noise levels whose A is found by a job."""
    return [
        f"{RESULTS}/noise/{noise}.json"
        for noise in dict.fromkeys(levels)
        if "meets" in PLAN.config["noise"]["levels"][noise]
    ]


def image_physics(wildcards):
    """Effects that act on a protocol's images."""
    return PLAN.config["protocols"][wildcards.protocol].get("image_physics", {})


def image_file(path):
    """An image as an output: deleted once it is used, if images are not kept."""
    return path if PLAN.config["keep_images"] else temp(path)


def acquisition_group(bundle):
    """Which jobs of a cluster a bundle's images and features may share. Those whose noise waits for other images do
    not go together with these."""
    waits = level_files(*(noise for noise, _ in bundle))
    return "matched_acquisitions" if waits else "acquisitions"


def reference_tables(wildcards):
    """The measured features that a figure of principal components shows: of recordings, or those kept here."""
    if names := ANALYSES["pca"][wildcards.pca]["recordings"]:
        return [f"{RESULTS}/recordings/{name}/features.csv" for name in names]
    measured = PLAN.config["measured"]
    if not measured["overlay"]:
        return []
    if measured["table"] is not None:
        return present(measured["table"])
    return [resource("ct_phantom4radiomics_groups.csv")]


@cache
def measured_noise():
    """The measured variances of the algorithms that the noise is calibrated with."""
    from virtual_phantom.statistics.measured import dose_variance

    if not PLAN.config["measured"]["overlay"]:
        return []
    calibrated = ANALYSES.get("noise_calibration", {}).get("protocols", [])
    algorithms = {
        PLAN.config["protocols"][protocol]["algorithm"] for protocol in calibrated
    }
    reconstructions = {"sirt": "iterative", "fbp": "fbp"}
    return [
        {
            "label": f"{dose} mGy, {'FBP' if algorithm == 'fbp' else 'iterative'}",
            "variance_hu2": float(dose_variance(reconstructions[algorithm], dose)),
        }
        for algorithm in sorted(algorithms, reverse=True)
        for dose in (1, 3, 10)
    ]


def scan_titles():
    """What the two images of analyses.optimal are called."""
    return {
        algorithm: f"{algorithm.upper()}, {PLAN.config['protocols'][ANALYSES['optimal'][algorithm]]['projections']} projections"
        for algorithm in ("fbp", "sirt")
        if "optimal" in ANALYSES
    }
