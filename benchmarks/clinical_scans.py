"""Clinical scans by another simulator, read as DICOM-CT-PD and diagnosed: one effect concealed, the others declared.

    python benchmarks/clinical_scans.py --seed 6 --cases 10 --out clinical

XCIST scans a body of its own surfaces with the geometry of a GE LightSpeed VCT (541 and 949.075 mm, an arc of 888
columns of 1.0239 mm and 16 rows of 1.0988 mm, column offset -1.25), with the physics of such a scanner (120 kV, bowtie,
large focal spot, crosstalk). Every case is written as DICOM-CT-PD, imported, and diagnosed by the project's own
commands, with what a physicist would state of the scanner. Half of the cases leave one effect of the scanner out of
that statement; the others have an effect that no scanner states beside them. Cases that are there already are not done
again.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml

from virtual_phantom.base.geometry import circular
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.io import dicom_ct_pd as pd
from virtual_phantom.io.dicom_export import write
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.xcist import TARGET_ANGLE_DEG, Scan, Surface, Surfaces, simulate

ROOT = Path(__file__).resolve().parents[1]
DETECTOR = {
    "source_to_isocentre_mm": 541.0,
    "source_to_detector_mm": 949.075,
    "columns": 888,
    "rows": 16,
    "column_pitch_mm": 1.0239,
    "row_pitch_mm": 1.0988,
    "surface": "cylindrical",
    "column_offset_px": -1.25,
}
VIEWS, ROTATION_MS, PHOTONS = 246, 1000.0, 3e5  # per turn, a quarter of the scanner's 984
SENSOR = "yttrium_gadolinium_oxide"  # the simulator's Lumex
LEAST_READING = 1e-6  # of the air scan
# XCIST's names of materials whose attenuation is the library's to 0.2 %, and the library's.
MATERIALS = {"water": "water", "plexi": "pmma", "Al": "aluminium", "air": "air"}
# Kind, material, centre and half-axes, mm: a body of 260 x 190 mm with inserts that end within the beam or do not.
BODY = (
    Surface("cylinder", "water", (0, 0, 0), (130, 95, 1000)),
    Surface("cylinder", "plexi", (-70, 15, 0), (20, 20, 1000)),
    Surface("cylinder", "Al", (75, -25, 0), (6, 6, 1000)),
    Surface("cylinder", "air", (30, 50, 0), (14, 14, 1000)),
    Surface("ellipsoid", "Al", (5, -40, 1), (12, 12, 5)),
    Surface("ellipsoid", "plexi", (-20, 55, -2), (16, 16, 6)),
)
# The scanner: settings of the simulator, and what is stated of each effect (value, standard deviation; 0: taken for
# exact). Of the bowtie it is the profile in its file, of the spectrum the aluminium that hardens water and aluminium on
# the central ray as the file's spectrum and 3 mm of aluminium do, with the 2.6 mm of the bowtie's middle. The sensor is
# stated as it is, but its thickness is not trusted: the simulator's sensor keeps all energy, the library's loses
# fluorescence, and reads the same at 1.6 mm.
SCANNER = {
    "spectrum": (
        {"kvp": 120.0, "aluminium_mm": 3.0},
        {"kvp": (120.0, 0.0), "filtration_mm": (10.8, 1.0), "sensor_mm": (3.0, 1.5)},
    ),
    "bowtie": (
        {"bowtie": "large", "bowtie_scale": 1.0},
        {"at_20deg_mm": (31.8, 1.0), "exponent": (3.54, 0.0), "levels_off_deg": (14.9, 0.0)},
    ),
    "focal_spot": ({"focal_spot_mm": (1.3, 1.3)}, {"width_mm": (1.3, 0.0), "length_mm": (1.3, 0.0)}),
    "xray_crosstalk": ({"crosstalk": (0.025, 0.02)}, {"column": (0.025, 0.0), "row": (0.02, 0.0)}),
    "optical_crosstalk": ({"optical_crosstalk": (0.04, 0.03)}, {"column": (0.04, 0.0), "row": (0.03, 0.0)}),
}
# What no scanner states, beside all of these.
BESIDE = ("scatter", "afterglow", "motion", "detector_offset", "current_modulation", "view_angle_error")


def case(number: int, seed: int) -> dict:
    """What a case conceals: the scanner's effects in turn, and between them what no scanner states."""
    random = generator(branch(seed, number))
    if number % 2 == 0:
        return {"concealed": list(SCANNER)[number // 2 % len(SCANNER)], "settings": {}, "comparable": {}}
    order = generator(branch(seed, 1000)).permutation(len(BESIDE))
    name = BESIDE[order[number // 2 % len(BESIDE)]]
    strength = str(random.choice(["medium", "strong"]))
    settings, comparable = CATALOGUE[name].draw(strength, random)
    return {"concealed": name, "strength": strength, "settings": settings, "comparable": comparable}


def scanned(one: dict, number: int, seed: int):
    """The case's scan, as XCIST reads it."""
    settings = {key: value for made, _ in SCANNER.values() for key, value in made.items()} | one["settings"]
    scan = Scan(VIEWS, kev=60.0, photons=PHOTONS, rotation_ms=ROTATION_MS, settings=settings, **DETECTOR)
    return simulate(scan, Surfaces(BODY, rays=4), 1, branch(seed, number, 1))


def write_dicom(taken, folder: Path) -> None:
    """One file per view, with the noise-equivalent quanta of every column in air."""
    geometry = circular(views=VIEWS, view_interval_ms=ROTATION_MS / VIEWS, **DETECTOR)
    readings = np.maximum(taken.readings[0], LEAST_READING * taken.air)
    quanta = [float(value) for value in taken.quanta.mean(axis=0)]
    for number, view in enumerate(pd.views_of(-np.log(readings / taken.air), geometry), start=1):
        view.KVP = 120
        view.add_new(pd.PHOTONS, "FL", quanta)
        write(view, folder / f"view{number:06d}.dcm")


def state_tube(path: Path) -> None:
    """The anode, which DICOM-CT-PD has no element for, written into the recording by hand."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["nominal"] |= {"anode": "W", "anode_angle_deg": TARGET_ANGLE_DEG, "sensor": {"material": SENSOR}}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_object(path: Path) -> None:
    """The body as an object of shapes: an elliptic cylinder as an ellipsoid too long to differ in the beam."""
    shapes = [
        {
            "kind": "ellipsoid",
            "material": MATERIALS[one.material],
            "centre_mm": list(one.centre_mm),
            "semi_axes_mm": list(one.half_axes_mm),
        }
        if one.kind == "ellipsoid" or one.half_axes_mm[0] != one.half_axes_mm[1]
        else {
            "kind": "cylinder",
            "material": MATERIALS[one.material],
            "centre_mm": list(one.centre_mm),
            "diameter_mm": 2 * one.half_axes_mm[0],
        }
        for one in BODY
    ]
    content = {"description": "A body with inserts.", "sources": ["made up"], "shapes": shapes}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def write_config(one: dict, folder: Path, view_step: int) -> Path:
    """The configuration of the diagnosis: what a physicist states of the scanner, but for what is concealed."""
    baseline = {
        name: {key: {"value": value, "sd": sd} for key, (value, sd) in stated.items()}
        for name, (_, stated) in SCANNER.items()
        if name != one["concealed"]
    }
    settings = {"object": {"kind": str(folder / "body.yaml")}, "baseline": baseline, "view_step": view_step}
    settings["samples"] = 2  # per direction; the focal spot has points of its own
    config = {
        "results_dir": str(folder / "results"),
        "recordings": {"clinic": str(folder / "recording")},
        "diagnosis": {"recordings": {"clinic": settings}},
    }
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    return path


def done(command: list[str]) -> None:
    """Run a command of the project in its root."""
    subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def diagnosed(number: int, options) -> dict:
    """A case from the scan to what is said of it."""
    folder = (options.out / f"case{number:02d}").resolve()
    path = folder / "results" / "diagnosis" / "clinic" / "diagnosis.json"
    one = case(number, options.seed)
    began = time.perf_counter()
    if not path.is_file():
        if not (folder / "recording").is_dir():
            write_dicom(scanned(one, number, options.seed), folder / "dicom")
            importer = Path(sys.executable).with_name("virtual-phantom-import")
            done([str(importer), "dicom-ct-pd", str(folder / "dicom"), str(folder / "recording")])
            state_tube(folder / "recording" / "recording.yaml")
        write_object(folder / "body.yaml")
        config = write_config(one, folder, options.view_step)
        snakemake = str(Path(sys.executable).with_name("snakemake"))
        done([snakemake, "diagnosis", "--cores", str(options.cores), "--configfile", str(config)])
    said = json.loads(path.read_text(encoding="utf-8"))
    return one | {"said": said, "seconds": time.perf_counter() - began}


def main() -> None:
    """Scan, diagnose and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--cases", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--view-step", type=int, default=15, help="one view of so many is fitted or held out")
    parser.add_argument("--cores", type=int, default=2, help="of one diagnosis")
    parser.add_argument("--out", type=Path, required=True, help="a folder, which keeps what was done")
    options = parser.parse_args()
    first = 0
    for number in range(options.first, options.first + options.cases):
        one = diagnosed(number, options)
        named = [effect["name"] for effect in one["said"]["effects"]]
        right = named[:1] == [one["concealed"]]
        first += right
        print(f"{number}: {one['concealed']}: {one['said']['sentence']} [{one['seconds']:.0f} s]", flush=True)
    print(f"named first in {first} of {options.cases}")


if __name__ == "__main__":
    main()
