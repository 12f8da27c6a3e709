"""Figure of stability against discriminative power, with the measured scores beside it where they apply."""

from virtual_phantom.figures import stability_discrimination, style
from virtual_phantom.io import files
from virtual_phantom.statistics import further_seeds, measured
from virtual_phantom.study.job import job

with job(snakemake):
    params = snakemake.params
    if params.recording:
        scores = files.read_csv(snakemake.input.scores)
    else:
        scores = measured.load_score_draws(params.seeds) if params.with_measured else None
    table = files.read_csv(snakemake.input.table)
    seeds = further_seeds.read_seed_scores()
    sd = further_seeds.sd_over_seeds(seeds) if further_seeds.match_settings(seeds, params.settings) else None
    intervals = files.read_csv(snakemake.input.trust)
    figure = stability_discrimination.draw(
        table, params.threshold, scores, repeats=params.seeds, sd=sd, intervals=intervals, noise=params.noise
    )
    style.save(figure, [snakemake.output.png, snakemake.output.pdf], trial=snakemake.params.trial)
