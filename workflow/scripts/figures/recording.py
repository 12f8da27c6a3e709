"""Figure of one recording of projections or images: its first repeat."""

from virtual_phantom.figures import recording as figures
from virtual_phantom.figures import style
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.scan import UNKNOWN
from virtual_phantom.study.job import job


def main(*, folder: str, outputs: list[str]) -> None:
    recording = load_recording(folder)
    first = recording.repeats[0]
    if recording.kind == "projections":
        line_integrals = first.line_integrals(figures.SMALLEST_TRANSMISSION)
        scan = recording.scan
        unit, known = scan.get("length_unit", "mm"), scan.get("angles_deg") != UNKNOWN
        figure = figures.draw_projections(line_integrals, recording.geometry, recording.name, unit, known)
    else:
        figure = figures.draw_images(first, recording.name)
    style.save(figure, outputs)


if "snakemake" in globals():
    with job(snakemake):
        main(
            folder=snakemake.params.folder,
            outputs=[snakemake.output.png, snakemake.output.pdf],
        )
