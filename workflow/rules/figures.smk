PCA_TITLES = {
    "sirt": "Iterative reconstruction (SIRT)",
    "fbp": "Filtered back-projection (FBP)",
    "multicentre": "Wider noise range (multi-centre)",
}
FIGURE_RESOURCES = {"mem_mb": 2000, "runtime": 10}


rule figure_rois:
    input:
        image=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("figures/rois.py"),
    output:
        png=report(
            f"{RESULTS}/figures/rois.png",
            caption="../report/rois.rst",
            category="Phantom",
            labels={"figure": "regions of interest"},
        ),
        pdf=f"{RESULTS}/figures/rois.pdf",
    log:
        f"{RESULTS}/logs/figure_rois.log",
    group:
        "analyses"
    resources:
        **FIGURE_RESOURCES,
    script:
        "../scripts/figures/rois.py"


rule figure_scans:
    input:
        **{
            algorithm: images(
                ANALYSES["optimal"][algorithm], ANALYSES["optimal"]["noise"]
            )[0]
            for algorithm in ("fbp", "sirt")
            if "optimal" in ANALYSES
        },
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=code("figures/scans.py"),
    output:
        png=report(
            f"{RESULTS}/figures/scans.png",
            caption="../report/scans.rst",
            category="Phantom",
            labels={"figure": "input, FBP and SIRT"},
        ),
        pdf=f"{RESULTS}/figures/scans.pdf",
    log:
        f"{RESULTS}/logs/figure_scans.log",
    group:
        "analyses"
    resources:
        **FIGURE_RESOURCES,
    params:
        titles=scan_titles(),
    script:
        "../scripts/figures/scans.py"


rule figure_noise_calibration:
    input:
        table=rules.noise_calibration.output[0],
        code=code("figures/noise_calibration.py"),
    output:
        png=report(
            f"{RESULTS}/figures/noise_calibration.png",
            caption="../report/noise_calibration.rst",
            category="Noise",
            labels={"figure": "noise calibration"},
        ),
        pdf=f"{RESULTS}/figures/noise_calibration.pdf",
    log:
        f"{RESULTS}/logs/figure_noise_calibration.log",
    group:
        "calibration"
    resources:
        **FIGURE_RESOURCES,
    params:
        study_levels={
            noise: PLAN.config["noise"]["levels"][noise]["A"]
            for noise in [ANALYSES.get("stability", {}).get("noise")]
            if "A" in PLAN.config["noise"]["levels"].get(noise, {})
        },
        measured=measured_noise(),
    script:
        "../scripts/figures/noise_calibration.py"


rule figure_stability_discrimination:
    input:
        table=rules.stability.output[0],
        scores=resource("ct_phantom4radiomics_draws.csv"),
        seeds=resource("default_study_seeds.csv"),
        code=code("figures/stability_discrimination.py"),
    output:
        png=report(
            f"{RESULTS}/figures/stability_discrimination.png",
            caption="../report/stability_discrimination.rst",
            category="Stability",
            labels={"figure": "stability and discriminative power"},
        ),
        pdf=f"{RESULTS}/figures/stability_discrimination.pdf",
    log:
        f"{RESULTS}/logs/figure_stability_discrimination.log",
    group:
        "analyses"
    resources:
        **FIGURE_RESOURCES,
    params:
        threshold=PLAN.config["statistics"]["threshold"],
        with_measured=PLAN.config["measured"]["overlay"],
        seeds=GROUPED["seeds"],
        settings=PLAN.scored_settings(),
    script:
        "../scripts/figures/stability_discrimination.py"


rule figure_overlap:
    input:
        table=rules.overlap.output[0],
        code=code("figures/overlap.py"),
    output:
        png=report(
            f"{RESULTS}/figures/overlap.png",
            caption="../report/overlap.rst",
            category="Stability",
            labels={"figure": "overlap with the measured phantom"},
        ),
        pdf=f"{RESULTS}/figures/overlap.pdf",
    log:
        f"{RESULTS}/logs/figure_overlap.log",
    group:
        "analyses"
    resources:
        **FIGURE_RESOURCES,
    script:
        "../scripts/figures/overlap.py"


for name, title in PCA_TITLES.items():

    rule:
        name:
            f"figure_pca_{name}"
        input:
            table=f"{RESULTS}/tables/pca_{name}.csv",
            code=code("figures/pca.py"),
        output:
            png=report(
                f"{RESULTS}/figures/pca_{name}.png",
                caption=f"../report/pca_{name}.rst",
                category="Principal components",
                labels={"figure": title},
            ),
            pdf=f"{RESULTS}/figures/pca_{name}.pdf",
        log:
            f"{RESULTS}/logs/figure_pca_{name}.log",
        group:
            "analyses"
        resources:
            **FIGURE_RESOURCES,
        params:
            title=title,
        script:
            "../scripts/figures/pca.py"
