rule figure_rois:
    input:
        image=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=context.code("figures/rois.py"),
    output:
        png=report(
            context.file("figure_rois", ".png"), **context.reported("figure_rois")
        ),
        pdf=context.file("figure_rois", ".pdf"),
    log:
        context.log("figure_rois"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    script:
        "../scripts/figures/rois.py"


rule figure_scans:
    input:
        **{
            algorithm: paths[0]
            for algorithm, paths in context.selections.optimal_images().items()
        },
        phantom=rules.phantom.output.image,
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        code=context.code("figures/scans.py"),
    output:
        png=report(
            context.file("figure_scans", ".png"), **context.reported("figure_scans")
        ),
        pdf=context.file("figure_scans", ".pdf"),
    log:
        context.log("figure_scans"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        titles=context.selections.scan_titles(),
        noise=context.selections.scan_noise(),
    script:
        "../scripts/figures/scans.py"


rule figure_noise_calibration:
    input:
        table=rules.noise_calibration.output[0],
        code=context.code("figures/noise_calibration.py"),
    output:
        png=report(
            context.file("figure_noise_calibration", ".png"),
            **context.reported("figure_noise_calibration"),
        ),
        pdf=context.file("figure_noise_calibration", ".pdf"),
    log:
        context.log("figure_noise_calibration"),
    group:
        "calibration"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        study_levels=context.selections.study_levels(),
        measured=lambda wildcards: context.selections.measured_noise,
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/noise_calibration.py"


rule figure_stability_discrimination:
    input:
        table=rules.stability.output[0],
        trust=rules.trust.output[0],
        scores=context.selections.measured_scores(),
        seeds=context.resource("default_study_seeds.csv"),
        code=context.code("figures/stability_discrimination.py"),
    output:
        png=report(
            context.file("figure_stability_discrimination", ".png"),
            **context.reported("figure_stability_discrimination"),
        ),
        pdf=context.file("figure_stability_discrimination", ".pdf"),
    log:
        context.log("figure_stability_discrimination"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        threshold=context.config["statistics"]["threshold"],
        with_measured=context.config["measured"]["overlay"],
        recording=context.selections.own_reference,
        seeds=context.selections.grouped["seeds"],
        settings=context.plan.scored_settings(),
        noise=context.selections.compared_noise(),
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/stability_discrimination.py"


rule figure_physics_change:
    input:
        table=rules.physics_change.output[0],
        code=context.code("figures/physics_change.py"),
    output:
        png=report(
            context.file("figure_physics_change", ".png"),
            **context.reported("figure_physics_change"),
        ),
        pdf=context.file("figure_physics_change", ".pdf"),
    log:
        context.log("figure_physics_change"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        threshold=context.config["statistics"]["threshold"],
        noise=context.selections.compared_noise(),
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/physics_change.py"


rule figure_overlap:
    input:
        table=rules.overlap.output[0],
        code=context.code("figures/overlap.py"),
    output:
        png=report(
            context.file("figure_overlap", ".png"),
            **context.reported("figure_overlap"),
        ),
        pdf=context.file("figure_overlap", ".pdf"),
    log:
        context.log("figure_overlap"),
    group:
        "analyses"
    resources:
        mem_mb=2000,
        runtime=10,
    params:
        trial=bool(context.config["trial"]),
    script:
        "../scripts/figures/overlap.py"


for name in context.selections.shown_components:

    rule:
        name:
            f"figure_pca_{name}"
        input:
            table=context.file("pca", pca=name),
            code=context.code("figures/pca.py"),
        output:
            png=report(
                context.file(f"figure_pca_{name}", ".png"),
                **context.reported(f"figure_pca_{name}"),
            ),
            pdf=context.file(f"figure_pca_{name}", ".pdf"),
        log:
            context.log(f"figure_pca_{name}"),
        group:
            "analyses"
        resources:
            mem_mb=2000,
            runtime=10,
        params:
            title=context.title(f"figure_pca_{name}"),
            trial=bool(context.config["trial"]),
        script:
            "../scripts/figures/pca.py"
