"""Stability and discriminative power of every feature over the groups of protocols."""

from virtual_phantom import feature_table, files
from virtual_phantom.feature_names import FEATURES
from virtual_phantom.job import job
from virtual_phantom.statistics import wilcoxon

with job(snakemake) as log:
    params = snakemake.params
    groups = dict(params.groups)
    table = feature_table.select(
        feature_table.read(str(snakemake.input.features)),
        protocols=list(groups),
        noise=[params.noise],
        seeds=params.seeds,
    )
    table = table.assign(group=table["protocol"].map(groups))
    scores = wilcoxon.scores(table, FEATURES, source=str(snakemake.input.features), **params.statistics)
    files.write_csv(scores, snakemake.output[0])
    log.info(
        "mean stability %.1f %%, mean discriminative power %.1f %%",
        scores["stability_percent"].mean(),
        scores["discrimination_percent"].mean(),
    )
