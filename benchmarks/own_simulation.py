"""Name the physics that a simulation by ASTRA lacks, in recordings by XCIST with one hidden effect (40 minutes).

Objects are the phantoms of the blind validation, constant along z. ASTRA projects the slice that XCIST scans with RAYS
rays per pixel, with one energy and no effect. Options::

    --seed     draws textures, strengths, signs and noise
    --beside   repeats each diagnosis with Virtual Phantom's own simulation of the slice
"""

import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np

import virtual_phantom as vp
from benchmarks.common.tuning_objects import OBJECTS, acquire, build, scan_of
from virtual_phantom.base.data import RESOURCES
from virtual_phantom.base.geometry import Grid
from virtual_phantom.base.streams import branch, generator
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.generate import write
from virtual_phantom.proof.hiding.voxels import BEYOND_MM, REACH
from virtual_phantom.proof.hiding.xcist import CELLS_DIVIDED, energy_of_water

COLUMNS, ROWS, VIEWS, PHOTONS, REPEATS, ROTATION_MS, RAYS = 64, 4, 96, 1e5, 4, 1000, 32
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
    parser.add_argument("--beside", action="store_true", help="also Virtual Phantom's own simulation")
    parser.add_argument("--output", help="JSON lines")


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
    import astra

    mu = np.maximum(mu_water * (1 + fine.array[0].astype(np.float64) / 1000), 0)
    (rows, columns), (_, height, width) = mu.shape, fine.grid.spacing
    volume = astra.create_vol_geom(
        rows,
        columns,
        *(
            half * side
            for side, half in (
                (columns * width, -0.5),
                (columns * width, 0.5),
                (rows * height, -0.5),
                (rows * height, 0.5),
            )
        ),
    )
    angles = np.arange(scan.views) * 2 * np.pi / scan.views
    sine, cosine = np.sin(angles), np.cos(angles)
    source, beyond = scan.source_to_isocentre_mm, scan.source_to_detector_mm - scan.source_to_isocentre_mm
    pitch = scan.column_pitch_mm / RAYS
    vectors = np.stack(
        [-source * sine, source * cosine, beyond * sine, -beyond * cosine, pitch * cosine, pitch * sine], axis=1
    )
    detector = astra.create_proj_geom("fanflat_vec", scan.columns * RAYS, vectors)
    projector = astra.create_projector("line_fanflat", detector, volume)
    number, lines = astra.create_sino(mu[::-1], projector)
    for module, one in ((astra.data2d, number), (astra.projector, projector)):
        module.delete(one)
    across = (np.arange(scan.columns * RAYS) - (scan.columns * RAYS - 1) / 2) * pitch
    up = (np.arange(scan.rows) - (scan.rows - 1) / 2) * scan.row_pitch_mm
    in_plane = np.hypot(across, scan.source_to_detector_mm)
    lines = lines[:, None] * np.hypot(in_plane, up[:, None]) / in_plane  # rays out of the plane are longer
    parts = lines.reshape(*lines.shape[:2], -1, CELLS_DIVIDED, RAYS // CELLS_DIVIDED).mean(axis=4)
    return -np.log(np.exp(-parts).mean(axis=3))


def recorded(folder, name, fine, hidden, seed):
    """Write a recording by XCIST; return the scan."""
    taken = {"columns": COLUMNS, "rows": ROWS, "views": VIEWS, "photons": PHOTONS, "rotation_time_ms": ROTATION_MS}
    orbit, scan = scan_of(OBJECTS[name], taken, energy_of_water(MU_WATER), hidden)
    readings = acquire(scan, OBJECTS[name], fine, MU_WATER, REPEATS, seed)
    write(folder, "scan", orbit, ROTATION_MS, readings, MU_WATER)
    return scan


def simulated(path, lines):
    """Write a simulation as line integrals."""
    with h5py.File(path, "w") as file:
        file.create_dataset("exchange/data", data=lines.astype(np.float32)).attrs["log"] = True
    return path


def cases(effects, none):
    """(hidden effect or None, strength) of all recordings."""
    return [(name, strength) for name in effects for strength in STRENGTHS] + [(None, None)] * none


def run(options):
    found = []
    for number, (name, strength) in enumerate(cases(options.effects, options.none)):
        root = branch(options.seed, number)
        phantom = tuple(OBJECTS)[number % len(OBJECTS)]
        fine = slice_of(phantom, branch(options.seed, 10_000 + number % len(OBJECTS)))
        hidden = CATALOGUE[name].draw(strength, generator(branch(options.seed, number, 1)))[0] if name else {}
        with TemporaryDirectory() as folder:
            folder, begin = Path(folder), time.time()
            scan = recorded(folder, phantom, fine, hidden, root)
            given = {"ASTRA": {"simulation": simulated(folder / "astra.h5", project(fine, scan))}}
            if options.beside:
                write_nifti(fine, folder / "slice.nii.gz")
                given["own"] = {"phantom": folder / "slice.nii.gz"}
            for which, scene in given.items():
                content = vp.diagnose(folder, check_setup=False, processes=1, **scene).content
                named = [effect["name"] for effect in content["effects"]]
                found.append(
                    {
                        "number": number,
                        "hidden": name,
                        "strength": strength,
                        "simulation": which,
                        "named": named,
                        "verdict": content["verdict"],
                        "alike": content["ambiguous_with"],
                    }
                )
                print(
                    f"{number:3} {which:5} {name or '-':20} {strength or '':7} {content['verdict']:28}",
                    ", ".join(named),
                    f"({time.time() - begin:.0f} s)",
                    flush=True,
                )
                if options.output:
                    with open(options.output, "a") as file:
                        file.write(json.dumps(found[-1]) + "\n")
    for which in dict.fromkeys(one["simulation"] for one in found):
        of = [one for one in found if one["simulation"] == which]
        with_effect, without = ([one for one in of if bool(one["hidden"]) is has] for has in (True, False))
        first = sum(one["named"][:1] == [one["hidden"]] for one in with_effect)
        print(
            f"{which}: named first {first} of {len(with_effect)}; false alarms "
            f"{sum(one['verdict'] != 'match' for one in without)} of {len(without)}"
        )
