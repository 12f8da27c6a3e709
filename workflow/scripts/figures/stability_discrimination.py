"""Figure of stability and discriminative power, with a second panel of measured scores if they are comparable."""

from collections.abc import Mapping

from virtual_phantom.figures import stability_discrimination, style
from virtual_phantom.io import files
from virtual_phantom.statistics import further_seeds, measured, ranking, robustness
from virtual_phantom.study.job import job


def main(
    *,
    table_file: str,
    controls_file: str,
    trust: str,
    scores_file: str | None,
    outputs: list[str],
    threshold: float,
    measured_acquisitions: str | None,
    recording: str | None,
    repeats: int,
    settings: Mapping,
    noise: Mapping,
    trial: bool,
) -> None:
    if recording:
        scores = ranking.assessed(files.read_csv(scores_file), scores_file)
    else:
        scores = measured.load_score_draws(repeats, measured_acquisitions) if measured_acquisitions else None
    table = ranking.assessed(files.read_csv(table_file), table_file)
    seeds = further_seeds.read_seed_scores()
    sd = further_seeds.sd_over_seeds(seeds) if further_seeds.match_settings(seeds, settings) else None
    intervals = robustness.between_protocols(files.read_csv(trust))
    controls = files.read_csv(controls_file)
    figure = stability_discrimination.draw(
        table, threshold, scores, repeats=repeats, sd=sd, intervals=intervals, noise=noise, controls=controls
    )
    style.save(figure, outputs, trial=trial)


if "snakemake" in globals():
    with job(snakemake):
        main(
            table_file=snakemake.input.table,
            controls_file=snakemake.input.controls,
            trust=snakemake.input.trust,
            scores_file=snakemake.input.get("scores"),
            outputs=[snakemake.output.png, snakemake.output.pdf],
            threshold=snakemake.params.threshold,
            measured_acquisitions=snakemake.params.measured_acquisitions,
            recording=snakemake.params.recording,
            repeats=snakemake.params.seeds,
            settings=snakemake.params.settings,
            noise=snakemake.params.noise,
            trial=snakemake.params.trial,
        )
