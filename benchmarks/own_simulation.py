"""Name the physics that a simulation by ASTRA lacks, in recordings by XCIST with one hidden effect (20 CPU minutes).

Objects are the phantoms of the blind validation, constant along z. ASTRA projects the slice that XCIST scans with RAYS
rays per pixel, with one energy and no effect. Options::

    --seed     draws textures, strengths, signs and noise
    --bone     repeats each diagnosis with path lengths in bone
    --beside   repeats each diagnosis with Virtual Phantom's own simulation of the slice
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np

import virtual_phantom as vp
from benchmarks import common
from benchmarks.common.engines import fan_projector
from benchmarks.common.tuning_objects import OBJECTS, acquire, build, materials, scan_of
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.proof.hiding.case import MATCHES
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.generate import write
from virtual_phantom.proof.hiding.voxels import BEYOND_MM, REACH
from virtual_phantom.proof.hiding.xcist import energy_of_water
from virtual_phantom.proof.scoring.verdicts import named_groups

COLUMNS, ROWS, VIEWS, PHOTONS, REPEATS, ROTATION_MS, RAYS = 64, 4, 96, 1e5, 4, 1000, 32
FINE = 4  # columns of the simulation in a pixel
MU_WATER = defaults_of()["mu_water_per_mm"]
SLICES = 12
HIDDEN = (
    *("spectrum", "scatter", "veiling_glare", "dark_signal", "focal_spot", "xray_crosstalk", "optical_crosstalk"),
    *("afterglow", "electronic_noise", "bowtie", "gain_pattern", "centre_of_rotation", "detector_offset"),
    *("source_distance", "motion", "off_focal_radiation", "view_blur", "detector_saturation", "focal_spot_wobble"),
    "view_angle_error",
)
STRENGTHS = ("medium", "strong")


def add_arguments(parser):
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", nargs="*", default=HIDDEN, help="effects to hide, each medium and strong")
    parser.add_argument("--none", type=int, default=20, help="recordings without an effect")
    parser.add_argument("--bone", action="store_true", help="also ASTRA with path lengths in bone")
    parser.add_argument("--beside", action="store_true", help="also Virtual Phantom's own simulation")
    parser.add_argument("--minutes", type=float, default=np.inf, help="start no case later")
    parser.add_argument("--output", help="JSON lines; cases in it are not repeated")


def slice_of(name, seed):
    """The phantom's middle slice, HU, constant along z over the height that the beam needs."""
    scanned = OBJECTS[name]
    fine = build(scanned, RESOURCES / scanned.layout, COLUMNS, ROWS, seed).fine
    middle = fine.array[fine.grid.shape[0] // 2]
    height = ROWS * scanned.pixel_mm(COLUMNS) * REACH + 2 * BEYOND_MM
    grid = Grid((SLICES, *middle.shape), (height / SLICES, *fine.grid.spacing[1:]))
    return Volume(np.repeat(middle[None], SLICES, axis=0), grid)


def project(fine, scan, mu_water=MU_WATER):
    """Line integrals by ASTRA's fan beam [view, row, column], from RAYS rays per pixel.

    As in XCIST, the transmissions of four parts of a pixel are averaged.
    """
    parts = line_integrals(np.maximum(mu_water * (1 + fine.array[0].astype(np.float64) / 1000), 0), fine.grid, scan)
    return -np.log(np.exp(-parts).mean(axis=3))


def bone_mm(phantom, fine, scan):
    """Mean path lengths through bone, by ASTRA."""
    scanned = OBJECTS[phantom]
    shares = materials(fine, scanned, scan.kev, MU_WATER).fractions
    return line_integrals(shares[scanned.dense][0].astype(np.float64), fine.grid, scan).mean(axis=3)


def line_integrals(slice_per_mm, grid, scan):
    """Integrals by ASTRA's fan beam, the mean of the rays of each part of a pixel [view, row, column, part]."""
    import astra

    angles = np.arange(scan.views) * 2 * np.pi / scan.views
    projector = fan_projector(scan, angles, slice_per_mm.shape, grid.spacing[1:], RAYS)
    number, lines = astra.create_sino(slice_per_mm[::-1], projector)
    for module, one in ((astra.data2d, number), (astra.projector, projector)):
        module.delete(one)
    across = (np.arange(scan.columns * RAYS) - (scan.columns * RAYS - 1) / 2) * scan.column_pitch_mm / RAYS
    up = (np.arange(scan.rows) - (scan.rows - 1) / 2) * scan.row_pitch_mm
    in_plane = np.hypot(across, scan.source_to_detector_mm)
    lines = lines[:, None] * np.hypot(in_plane, up[:, None]) / in_plane  # rays out of the plane are longer
    return lines.reshape(*lines.shape[:2], -1, FINE, RAYS // FINE).mean(axis=4)


def recorded(folder, name, fine, hidden, seed):
    """Write a recording by XCIST; return the scan."""
    taken = {"columns": COLUMNS, "rows": ROWS, "views": VIEWS, "photons": PHOTONS, "rotation_time_ms": ROTATION_MS}
    orbit, scan = scan_of(OBJECTS[name], taken, energy_of_water(MU_WATER), hidden)
    readings = acquire(scan, OBJECTS[name], fine, MU_WATER, REPEATS, seed)
    write(folder, "scan", orbit, ROTATION_MS, readings, MU_WATER)
    return scan


def simulated(path, lines, path_lengths_mm=None):
    """Write a simulation as line integrals, with path lengths by material."""
    with h5py.File(path, "w") as file:
        file.create_dataset("exchange/data", data=lines.astype(np.float32)).attrs["log"] = True
        for material, lengths in (path_lengths_mm or {}).items():
            file.create_dataset(f"path_lengths_mm/{material}", data=lengths.astype(np.float32))
    return path


def cases(effects, none):
    """(hidden effect or None, strength) of all recordings."""
    return [(name, strength) for name in effects for strength in STRENGTHS] + [(None, None)] * none


def diagnosed(number, name, strength, options, done):
    """Yield the result of each simulation of one case that is not done."""
    phantom = tuple(OBJECTS)[number % len(OBJECTS)]
    wanted = ["ASTRA"] + ["ASTRA, bone"] * options.bone + ["Virtual Phantom"] * options.beside
    wanted = [simulation for simulation in wanted if (number, simulation) not in done]
    if not wanted:
        return
    fine = slice_of(phantom, branch(options.seed, 10_000 + number % len(OBJECTS)))
    hidden = CATALOGUE[name].draw(strength, generator(branch(options.seed, number, 1)))[0] if name else {}
    with TemporaryDirectory() as folder:
        folder = Path(folder)
        scan = recorded(folder, phantom, fine, hidden, branch(options.seed, number))
        write_nifti(fine, folder / "slice.nii.gz")
        lines = project(fine, scan)
        for simulation in wanted:
            if simulation == "Virtual Phantom":
                scene = {"phantom": folder / "slice.nii.gz"}
            else:
                paths = {"bone": bone_mm(phantom, fine, scan)} if simulation != "ASTRA" else {}
                scene = {"simulation": simulated(folder / f"{len(paths)}.h5", lines, paths)}
            begin = time.process_time()
            content = vp.diagnose(folder, check_setup=False, processes=1, **scene).content
            yield {
                "number": number,
                "hidden": name,
                "strength": strength,
                "simulation": simulation,
                "named": [effect["name"] for effect in content["effects"]],
                "verdict": content["verdict"],
                "alike": content["ambiguous_with"],
                "score": named_first(name, content),
                "seconds": round(time.process_time() - begin, 1),
                "settings": {key: np.asarray(value).tolist() for key, value in hidden.items()},
            }


def named_first(name, content):
    """1, or 1/k if the hidden effect is one of k that are named first as equal; otherwise 0."""
    group, *_ = named_groups(content) or [()]
    return 1 / len(group) if name in group else 0.0


def run(options):
    output, begin = Path(options.output) if options.output else None, time.monotonic()
    found = common.read_jsonl(output) if output else []
    done = {(one["number"], one["simulation"]) for one in found}
    for number, (name, strength) in enumerate(cases(options.effects, options.none)):
        if time.monotonic() - begin > 60 * options.minutes:
            break
        for one in diagnosed(number, name, strength, options, done):
            found.append(one)
            print(
                f"{number:3} {one['simulation']:15} {name or '-':20} {strength or '':7} {one['score']:.2f}",
                f"{one['verdict']}: {', '.join(one['named'])} ({one['seconds']:.0f} s)",
                flush=True,
            )
            if output:
                common.append_jsonl(output, one)
    for simulation in dict.fromkeys(one["simulation"] for one in found):
        of = [one for one in found if one["simulation"] == simulation]
        with_effect, without = ([one for one in of if bool(one["hidden"]) is has] for has in (True, False))
        print(
            f"{simulation}: named first {sum(one['score'] for one in with_effect):.4g} of {len(with_effect)}; "
            f"false alarms {sum(one['verdict'] not in MATCHES for one in without)} of {len(without)}"
        )
