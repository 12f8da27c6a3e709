from virtual_phantom.config.outputs import BY_NAME, PCA

selections = context.selections


rule figure_rois:
    input:
        image=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
    output:
        png=reported("figures/rois.png"),
        pdf=results("figures/rois.pdf"),
    log:
        results("logs/figure_rois.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        code=code("figures/rois.py"),
    script:
        "../scripts/figures/rois.py"


rule figure_scans:
    input:
        **{
            algorithm: paths[0]
            for algorithm, paths in selections.optimal_images().items()
        },
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
    output:
        png=reported("figures/scans.png"),
        pdf=results("figures/scans.pdf"),
    log:
        results("logs/figure_scans.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        titles=selections.scan_titles(),
        noise=selections.scan_noise(),
        code=code("figures/scans.py"),
    script:
        "../scripts/figures/scans.py"


rule figure_noise_calibration:
    input:
        table=rules.noise_calibration.output[0],
    output:
        png=reported("figures/noise_calibration.png"),
        pdf=results("figures/noise_calibration.pdf"),
    log:
        results("logs/figure_noise_calibration.log"),
    group:
        "calibration"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        study_levels=selections.study_levels(),
        measured=lambda wildcards: selections.measured_noise,
        trial=bool(context.study.trial),
        code=code("figures/noise_calibration.py"),
    script:
        "../scripts/figures/noise_calibration.py"


rule figure_trust_map:
    input:
        table=rules.trust.output.table,
    output:
        png=reported("figures/trust_map.png"),
        pdf=results("figures/trust_map.pdf"),
    log:
        results("logs/figure_trust_map.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        cut_offs=selections.cut_offs,
        trial=bool(context.study.trial),
        code=code("figures/trust_map.py"),
    script:
        "../scripts/figures/trust_map.py"


rule figure_stability_discrimination:
    input:
        table=rules.stability.output.scores,
        controls=rules.stability.output.controls,
        trust=rules.trust.output[0],
        scores=selections.measured_scores(),
        seeds=resource("default_study_seeds.csv"),
    output:
        png=reported("figures/stability_discrimination.png"),
        pdf=results("figures/stability_discrimination.pdf"),
    log:
        results("logs/figure_stability_discrimination.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        threshold=context.study.statistics.threshold,
        measured_acquisitions=selections.measured_acquisitions,
        recording=selections.own_reference,
        seeds=selections.compared_images()["seeds"],
        settings=context.plan.scored_settings(),
        noise=selections.compared_noise(),
        trial=bool(context.study.trial),
        code=code("figures/stability_discrimination.py"),
    script:
        "../scripts/figures/stability_discrimination.py"


rule figure_physics_change:
    input:
        table=rules.physics_change.output[0],
    output:
        png=reported("figures/physics_change.png"),
        pdf=results("figures/physics_change.pdf"),
    log:
        results("logs/figure_physics_change.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        threshold=context.study.statistics.threshold,
        noise=selections.compared_noise(),
        trial=bool(context.study.trial),
        code=code("figures/physics_change.py"),
    script:
        "../scripts/figures/physics_change.py"


rule figure_overlap:
    input:
        table=rules.overlap.output[0],
    output:
        png=reported("figures/overlap.png"),
        pdf=results("figures/overlap.pdf"),
    log:
        results("logs/figure_overlap.log"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        trial=bool(context.study.trial),
        code=code("figures/overlap.py"),
    script:
        "../scripts/figures/overlap.py"


for name in PCA:

    rule:
        name:
            f"figure_pca_{name}"
        input:
            table=results(f"tables/pca_{name}.csv"),
        output:
            png=reported(f"figures/pca_{name}.png"),
            pdf=results(f"figures/pca_{name}.pdf"),
        log:
            results(f"logs/figure_pca_{name}.log"),
        group:
            "analyses"
        resources:
            mem_mb=2000,
            runtime=10,
        params:
            title=BY_NAME[f"figure_pca_{name}"].title,
            trial=bool(context.study.trial),
            code=code("figures/pca.py"),
        script:
            "../scripts/figures/pca.py"
