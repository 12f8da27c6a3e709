"""Build a phantom of the blind validation: the scanned fine phantom, and the image that the diagnosis gets."""

from pathlib import Path

from virtual_phantom.base.proof_settings import ProofScan
from virtual_phantom.base.settings import from_mapping
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.phantom import write_phantom
from virtual_phantom.proof.hiding.objects import OBJECTS
from virtual_phantom.proof.hiding.phantoms import build
from virtual_phantom.study.job import job, log


def main(
    *,
    layout: str,
    output: str,
    name: str,
    scan: ProofScan,
    study_seed: int,
) -> None:
    phantom_object = OBJECTS[name]
    seed = branch(study_seed, Branch.PROOF_PHANTOM)
    phantom = build(phantom_object, layout, scan.columns, scan.rows, seed)
    write_phantom(phantom, Path(output).parent)
    log.info("scanned on %s, known on %s", phantom.fine.grid, phantom.image.grid)


if "snakemake" in globals():
    with job(snakemake):
        main(
            layout=snakemake.input.layout,
            output=snakemake.output.image,
            name=snakemake.wildcards.phantom,
            scan=from_mapping(ProofScan, snakemake.params.scan),
            study_seed=snakemake.params.seed,
        )
