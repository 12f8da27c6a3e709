"""Compare extraction settings: features of all, robustness and discrimination, and the most robust of each feature."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from virtual_phantom.features.tables import read_features, select
from virtual_phantom.features.variations import OWN
from virtual_phantom.io import files
from virtual_phantom.statistics import extraction_settings
from virtual_phantom.study.job import job, log


def main(
    *,
    features_file: str,
    setting_files: Sequence[str],
    features_output: str,
    settings_output: str,
    choice_output: str,
    images: Sequence[tuple[str, str]],
    seeds: int,
    variations: Mapping[str, Mapping],
    statistics: Mapping,
) -> None:
    conditions = {tuple(pair): number for number, pair in enumerate(images, 1)}
    own = read_features(features_file)
    parts = {OWN: [select(own, protocols=[protocol], noise=[noise], seeds=seeds) for protocol, noise in conditions]}
    for path in map(Path, setting_files):
        setting, protocol, noise = path.parts[-3], path.parts[-2], path.stem
        parts.setdefault(setting, []).append(files.read_csv(path).assign(protocol=protocol, noise=noise))
    tables = {name: pd.concat(tables, ignore_index=True) for name, tables in parts.items()}
    tables = {
        name: table.assign(group=[conditions[pair] for pair in zip(table["protocol"], table["noise"], strict=True)])
        for name, table in tables.items()
    }
    files.write_csv(extraction_settings.long_table(tables, variations), features_output)
    found = extraction_settings.settings_table(tables, **statistics)
    files.write_csv(found, settings_output)
    choice = extraction_settings.choice_table(found)
    files.write_csv(choice, choice_output)
    log.info("most robust setting: %s", choice["setting"].value_counts().to_dict())


if "snakemake" in globals():
    with job(snakemake):
        main(
            features_file=snakemake.input.features,
            setting_files=snakemake.input.settings,
            features_output=snakemake.output.features,
            settings_output=snakemake.output.settings,
            choice_output=snakemake.output.choice,
            images=snakemake.params.images,
            seeds=snakemake.params.seeds,
            variations=snakemake.params.variations,
            statistics=snakemake.params.statistics,
        )
