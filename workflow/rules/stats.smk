# The images whose features are compared between groups of protocols.
GROUPED = {
    "groups": PLAN.groups(),
    "noise": ANALYSES.get("stability", {}).get("noise"),
    "seeds": (
        PLAN.repeats([ANALYSES["stability"]["noise"]]) if "stability" in ANALYSES else 0
    ),
}


rule stability:
    """W over pairs of groups and pairs of classes, for every feature."""
    input:
        features=f"{RESULTS}/features.csv",
        code=code("stability.py"),
    output:
        f"{RESULTS}/tables/stability.csv",
    log:
        f"{RESULTS}/logs/stability.log",
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **GROUPED,
        statistics=PLAN.config["statistics"],
    script:
        "../scripts/stability.py"


rule stability_measures:
    """ICC, CCC and coefficients of variation beside W, and which features are stable by which."""
    input:
        features=f"{RESULTS}/features.csv",
        stability=rules.stability.output[0],
        code=code("stability_measures.py"),
    output:
        measures=report(
            f"{RESULTS}/tables/stability_measures.csv",
            caption="../report/stability_measures.rst",
            category="Stability",
            labels={"table": "measures of stability"},
        ),
        features=report(
            f"{RESULTS}/tables/stable_features.csv",
            caption="../report/stability_measures.rst",
            category="Stability",
            labels={"table": "stable features by measure"},
        ),
    log:
        f"{RESULTS}/logs/stability_measures.log",
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **GROUPED,
        cut_offs=ANALYSES.get("stability", {}).get("cut_offs"),
    script:
        "../scripts/stability_measures.py"


rule top_features:
    """The ten best features beside the paper's."""
    input:
        stability=rules.stability.output[0],
        published=resource("published_top_features.csv"),
        scores=resource("ct_phantom4radiomics_draws.csv"),
        code=code("top_features.py"),
    output:
        report(
            f"{RESULTS}/tables/top_features.csv",
            caption="../report/top_features.rst",
            category="Stability",
            labels={"table": "ten best features"},
        ),
    log:
        f"{RESULTS}/logs/top_features.log",
    group:
        "analyses"
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        seeds=GROUPED["seeds"],
        with_measured=PLAN.config["measured"]["overlay"],
    script:
        "../scripts/top_features.py"


rule overlap:
    """How many of the best features are also the measured phantom's best."""
    input:
        features=f"{RESULTS}/features.csv",
        scores=resource("ct_phantom4radiomics_draws.csv"),
        code=code("overlap.py"),
    output:
        f"{RESULTS}/tables/overlap.csv",
    log:
        f"{RESULTS}/logs/overlap.log",
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        **GROUPED,
        statistics=PLAN.config["statistics"],
        recording=None,
    script:
        "../scripts/overlap.py"


rule pca:
    """The first two principal components of all images and ROIs of a selection of protocols."""
    input:
        features=f"{RESULTS}/features.csv",
        measured=reference_tables,
        code=code("pca.py"),
    output:
        table=f"{RESULTS}/tables/pca_{{pca}}.csv",
        separability=f"{RESULTS}/tables/separability_{{pca}}.csv",
    log:
        f"{RESULTS}/logs/pca_{{pca}}.log",
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        selection=lambda wildcards: {
            "protocols": ANALYSES["pca"][wildcards.pca]["protocols"],
            "noise": ANALYSES["pca"][wildcards.pca]["noise"],
            "seeds": PLAN.repeats(ANALYSES["pca"][wildcards.pca]["noise"]),
        },
        pca=lambda wildcards: {
            key: ANALYSES["pca"][wildcards.pca][key]
            for key in ("fit_on", "standardise")
        },
        measured=PLAN.config["measured"],
        recordings=lambda wildcards: ANALYSES["pca"][wildcards.pca]["recordings"],
        conditions=lambda wildcards: {
            name: conditions_of(name)
            for name in ANALYSES["pca"][wildcards.pca]["recordings"]
        },
    script:
        "../scripts/pca.py"


CALIBRATION = [
    {"protocol": protocol, "noise": noise, "seed": seed}
    for protocol in ANALYSES.get("noise_calibration", {}).get("protocols", [])
    for noise in ANALYSES["noise_calibration"]["noise"]
    for seed in PLAN.seeds(noise)
]


rule noise_calibration:
    """Variance over repeats, averaged over voxels, against the noise level."""
    input:
        images=[
            f"{RESULTS}/images/{one['protocol']}/{one['noise']}/seed{one['seed']}.nii.gz"
            for one in CALIBRATION
        ],
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("noise_calibration.py"),
    output:
        f"{RESULTS}/tables/noise_calibration.csv",
    log:
        f"{RESULTS}/logs/noise_calibration.log",
    group:
        "calibration"
    resources:
        mem_mb=megabytes(volumes=12),
        runtime=lambda wildcards, attempt: attempt
        * minutes(RATES, "noise_calibration", SIZES.images(len(CALIBRATION))),
    params:
        acquisitions=[
            {"protocol": one["protocol"], **acquisition(one["noise"], one["seed"])}
            for one in CALIBRATION
        ],
    script:
        "../scripts/noise_calibration.py"


rule parquet:
    """Every table as Parquet too."""
    input:
        tables=[f"{table}.csv" for table in tables()],
        code=code("parquet.py"),
    output:
        [f"{table}.parquet" for table in tables()],
    log:
        f"{RESULTS}/logs/parquet.log",
    resources:
        mem_mb=2000,
        runtime=15,
    script:
        "../scripts/parquet.py"
