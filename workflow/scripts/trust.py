"""Which features can be trusted: stability with its interval, what it rests on, and a sentence for each."""

from virtual_phantom.features import tables
from virtual_phantom.features.names import features_of
from virtual_phantom.io import files
from virtual_phantom.statistics import trust
from virtual_phantom.study.job import job

with job(snakemake) as log:
    params = snakemake.params
    source = str(snakemake.input.features)
    groups = dict(params.groups)
    table = tables.select_groups(tables.read_features(source), groups, noise=params.noise, seeds=params.seeds)
    sharing = {groups[protocol]: label for protocol, label in params.sharing.items()}
    found = trust.trust_table(
        table,
        features_of(table),
        sharing,
        params.cut_offs["w_stability_percent"],
        threshold=params.statistics["threshold"],
        compare=params.statistics["compare"],
        source=source,
    )
    files.write_csv(found, snakemake.output[0])
    counts = found["stable"].value_counts()
    log.info(
        "%d features: %d stable, %d not stable, %d undecided",
        len(found),
        *(counts.get(verdict, 0) for verdict in ("yes", "no", "undecided")),
    )
