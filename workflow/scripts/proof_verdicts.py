"""Store a hash of every diagnosis of the blind validation before the hidden effects are revealed.

The hash shows later that no diagnosis was changed after the hidden effects were known.
"""

from collections.abc import Sequence
from pathlib import Path

from virtual_phantom.proof.hiding import seal
from virtual_phantom.study.job import job


def main(*, diagnoses: Sequence[str], others: Sequence[str], outputs: Sequence[str]) -> None:
    for diagnosis, other, path in zip(diagnoses, others, outputs, strict=True):
        seal.write(seal.verdict_of(Path(path).stem, diagnosis, other), path)


if "snakemake" in globals():
    with job(snakemake):
        main(
            diagnoses=snakemake.input.diagnoses,
            others=snakemake.input.others,
            outputs=snakemake.output,
        )
