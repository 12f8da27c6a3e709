# Simulation and recordings side by side: matched noise, features, overlap.
COMPARISONS = ANALYSES.get("comparison", {})
MATCHED = [
    noise for noise, level in PLAN.config["noise"]["levels"].items() if "meets" in level
]


wildcard_constraints:
    comparison="[A-Za-z0-9_]+",


rule recording_features:
    """Features of a recording in HU, one row per image and ROI."""
    input:
        unpack(recording_inputs),
        code=code("recording_features.py"),
    output:
        f"{RESULTS}/recordings/{{recording}}/features.csv",
    log:
        f"{RESULTS}/logs/recording_features/{{recording}}.log",
    resources:
        mem_mb=recording_megabytes,
        runtime=120,
    params:
        folder=lambda wildcards: str(RECORDINGS[wildcards.recording].folder),
    script:
        "../scripts/recording_features.py"


rule match_noise:
    """The A of a noise level that is to meet a recording."""
    input:
        calibration=rules.noise_calibration.output[0],
        recorded=lambda wildcards: "{}/recordings/{}/features.csv".format(
            RESULTS,
            PLAN.config["noise"]["levels"][wildcards.noise]["meets"]["recording"],
        ),
        code=code("match_noise.py"),
    output:
        f"{RESULTS}/noise/{{noise}}.json",
    log:
        f"{RESULTS}/logs/match_noise/{{noise}}.log",
    resources:
        mem_mb=1000,
        runtime=10,
    params:
        meets=lambda wildcards: PLAN.config["noise"]["levels"][wildcards.noise]["meets"],
    script:
        "../scripts/match_noise.py"


rule matched_noise:
    """How well the matched levels meet their recordings."""
    input:
        levels=level_files(*MATCHED),
        features=rules.merge_features.output[0],
        code=code("matched_noise.py"),
    output:
        report(
            f"{RESULTS}/tables/matched_noise.csv",
            caption="../report/matched_noise.rst",
            category="Recordings",
            labels={"table": "matched noise levels"},
        ),
    log:
        f"{RESULTS}/logs/matched_noise.log",
    resources:
        mem_mb=1000,
        runtime=10,
    script:
        "../scripts/matched_noise.py"


rule compare:
    """Every feature and ROI of one protocol and noise level against a recording."""
    input:
        features=rules.merge_features.output[0],
        recorded=lambda wildcards: "{}/recordings/{}/features.csv".format(
            RESULTS, COMPARISONS[wildcards.comparison]["recording"]
        ),
        code=code("compare.py"),
    output:
        cells=f"{RESULTS}/tables/comparison_{{comparison}}.csv",
        features=f"{RESULTS}/tables/comparison_{{comparison}}_features.csv",
        families=f"{RESULTS}/tables/comparison_{{comparison}}_families.csv",
    log:
        f"{RESULTS}/logs/compare/{{comparison}}.log",
    wildcard_constraints:
        comparison="|".join(COMPARISONS) or "none",
    resources:
        mem_mb=1500,
        runtime=15,
    params:
        recording=lambda wildcards: COMPARISONS[wildcards.comparison]["recording"],
        where=lambda wildcards: COMPARISONS[wildcards.comparison]["where"],
        protocol=lambda wildcards: COMPARISONS[wildcards.comparison]["protocol"],
        noise=lambda wildcards: COMPARISONS[wildcards.comparison]["noise"],
        seeds=lambda wildcards: PLAN.repeats(
            [COMPARISONS[wildcards.comparison]["noise"]]
        ),
        rois=lambda wildcards: COMPARISONS[wildcards.comparison].get("rois"),
        margin_sd=lambda wildcards: COMPARISONS[wildcards.comparison]["margin_sd"],
    script:
        "../scripts/compare.py"


rule figure_comparison:
    """Heat map of one comparison."""
    input:
        cells=rules.compare.output.cells,
        features=rules.compare.output.features,
        code=code("figures/comparison.py"),
    output:
        png=report(
            f"{RESULTS}/figures/comparison_{{comparison}}.png",
            caption="../report/comparison.rst",
            category="Recordings",
            labels={"figure": "comparison {comparison}"},
        ),
        pdf=f"{RESULTS}/figures/comparison_{{comparison}}.pdf",
    log:
        f"{RESULTS}/logs/figure_comparison/{{comparison}}.log",
    resources:
        **FIGURE_RESOURCES,
    params:
        title=comparison_title,
    script:
        "../scripts/figures/comparison.py"


rule attribute:
    """Which property of the images explains that features miss a recording's."""
    input:
        images=lambda wildcards: expand(
            f"{RESULTS}/images/{{protocol}}/{{noise}}/seed{{seed}}.nii.gz",
            protocol=COMPARISONS[wildcards.comparison]["protocol"],
            noise=COMPARISONS[wildcards.comparison]["noise"],
            seed=PLAN.seeds(COMPARISONS[wildcards.comparison]["noise"]),
        ),
        rois=rules.phantom.output.table,
        masks=rules.phantom.output.rois,
        recorded=lambda wildcards: "{}/recordings/{}/features.csv".format(
            RESULTS, COMPARISONS[wildcards.comparison]["recording"]
        ),
        code=code("attribute.py"),
    output:
        properties=f"{RESULTS}/tables/attribution_{{comparison}}.csv",
        cells=f"{RESULTS}/tables/attribution_{{comparison}}_cells.csv",
    log:
        f"{RESULTS}/logs/attribute/{{comparison}}.log",
    wildcard_constraints:
        comparison="|".join(COMPARISONS) or "none",
    resources:
        mem_mb=megabytes(volumes=60),
        runtime=60,
    params:
        recording=lambda wildcards: COMPARISONS[wildcards.comparison]["recording"],
        where=lambda wildcards: COMPARISONS[wildcards.comparison]["where"],
        rois=lambda wildcards: COMPARISONS[wildcards.comparison].get("rois"),
        margin_sd=lambda wildcards: COMPARISONS[wildcards.comparison]["margin_sd"],
        voxel_mm=lambda wildcards: RECORDINGS[
            COMPARISONS[wildcards.comparison]["recording"]
        ]
        .content["nominal"]
        .get("voxel_mm"),
    script:
        "../scripts/attribute.py"


rule figure_attribution:
    """What each property explains, by family of features."""
    input:
        table=rules.attribute.output.properties,
        code=code("figures/attribution.py"),
    output:
        png=report(
            f"{RESULTS}/figures/attribution_{{comparison}}.png",
            caption="../report/attribution.rst",
            category="Recordings",
            labels={"figure": "attribution {comparison}"},
        ),
        pdf=f"{RESULTS}/figures/attribution_{{comparison}}.pdf",
    log:
        f"{RESULTS}/logs/figure_attribution/{{comparison}}.log",
    resources:
        **FIGURE_RESOURCES,
    params:
        title=comparison_title,
    script:
        "../scripts/figures/attribution.py"


rule recording_scores:
    """Stability and discriminative power of a recording's features."""
    input:
        files=lambda wildcards: [
            str(path) for path in RECORDINGS[wildcards.recording].files
        ],
        code=code("recording_scores.py"),
    output:
        f"{RESULTS}/recordings/{{recording}}/scores.csv",
    log:
        f"{RESULTS}/logs/recording_scores/{{recording}}.log",
    resources:
        mem_mb=2000,
        runtime=15,
    params:
        folder=lambda wildcards: str(RECORDINGS[wildcards.recording].folder),
        repeats=GROUPED["seeds"],
        statistics=PLAN.config["statistics"],
    script:
        "../scripts/recording_scores.py"


use rule overlap as overlap_recording with:
    input:
        features=f"{RESULTS}/features.csv",
        scores=f"{RESULTS}/recordings/{{recording}}/scores.csv",
        code=code("overlap.py"),
    output:
        f"{RESULTS}/tables/overlap_{{recording}}.csv",
    log:
        f"{RESULTS}/logs/overlap/{{recording}}.log",
    params:
        **GROUPED,
        statistics=PLAN.config["statistics"],
        recording=lambda wildcards: wildcards.recording,


use rule figure_overlap as figure_overlap_recording with:
    input:
        table=f"{RESULTS}/tables/overlap_{{recording}}.csv",
        code=code("figures/overlap.py"),
    output:
        png=report(
            f"{RESULTS}/figures/overlap_{{recording}}.png",
            caption="../report/overlap_recording.rst",
            category="Recordings",
            labels={"figure": "overlap with {recording}"},
        ),
        pdf=f"{RESULTS}/figures/overlap_{{recording}}.pdf",
    log:
        f"{RESULTS}/logs/figure_overlap/{{recording}}.log",
