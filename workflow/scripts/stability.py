"""Stability and discriminative power of every feature over the groups of protocols."""

from virtual_phantom.features import tables
from virtual_phantom.features.names import features_of
from virtual_phantom.io import files
from virtual_phantom.statistics import wilcoxon
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    source = str(snakemake.input.features)
    table = tables.select_groups(
        tables.read_features(source), dict(params.groups), noise=params.noise, seeds=params.seeds
    )
    scores = wilcoxon.scores(table, features_of(table), source=source, **params.statistics)
    files.write_csv(scores, snakemake.output[0])
    log.info(
        "mean stability %.1f %%, mean discriminative power %.1f %%",
        scores["stability_percent"].mean(),
        scores["discrimination_percent"].mean(),
    )
