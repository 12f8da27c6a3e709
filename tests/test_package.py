"""The installed package without the project's folder: library, data files, and the importer's command."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import warm
from scipy.io import savemat

import virtual_phantom
from virtual_phantom.base.compiled import LIBRARY, PACKAGE_CACHE

ROOT = Path(__file__).resolve().parents[1]
PIP = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
STUDY = """
import numpy as np
import virtual_phantom
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.features.extraction import extract
from virtual_phantom.phantom import layout, synthetic
from virtual_phantom.simulation.reconstruct import reconstruct
from virtual_phantom.physics.scenes.line_integrals import clean_line_integrals
from virtual_phantom.simulation.acquire import simulate_counts
from virtual_phantom.base.settings import FbpSettings

MU_WATER_PER_MM = 0.0193
scanner = {"source_to_isocentre_mm": 500.0, "source_to_detector_mm": 1000.0}
detector = {"columns": 100, "rows": 30, "column_pitch_mm": 7.0, "row_pitch_mm": 10.0}
grid = Grid((24, 80, 80), (4.0, 3.75, 3.75))
phantom = synthetic.build(layout.read_layout(), grid, 1, np.random.SeedSequence(1))
scan = circular(views=90, **scanner, **detector)
lines = clean_line_integrals(phantom.fine, scan, MU_WATER_PER_MM)
noisy = simulate_counts(lines, 1e-6, "astra", np.random.SeedSequence(2)).line_integrals(0.5)
settings = FbpSettings("coverage")
image, = reconstruct(noisy[None], scan, grid, "fbp", settings, engine="cpu", mu_water_per_mm=MU_WATER_PER_MM)
features = extract(image, {roi.name: roi.mask for roi in phantom.rois})
measured = features.set_index("roi")["original_firstorder_Mean"]
for roi in phantom.rois:
    print(roi.name, measured[roi.name], phantom.image.array[roi.mask].mean())
print(virtual_phantom.__file__)
"""


def run(*command, cwd, **environment):
    """Output of a program that runs in a folder with this interpreter's packages."""
    environment = os.environ | environment
    process = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stderr[-3000:]
    return process.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A folder into which pip installed the wheel. Building writes into the sources, so it uses a copy."""
    source, wheels, target = (tmp_path_factory.mktemp(name) for name in ("source", "wheels", "target"))
    for name in ("pyproject.toml", "LICENSE"):
        shutil.copy2(ROOT / name, source)
    leave_out = shutil.ignore_patterns("__pycache__", "*.egg-info", "*.tmp.*")
    shutil.copytree(ROOT / "workflow" / "lib", source / "workflow" / "lib", ignore=leave_out)
    alone = ("--no-index", "--no-deps")
    run(*PIP, "wheel", *alone, "--no-build-isolation", "--wheel-dir", str(wheels), ".", cwd=source)
    (wheel,) = wheels.glob("virtual_phantom-*.whl")
    assert wheel.name.split("-")[1] == virtual_phantom.__version__
    run(*PIP, "install", *alone, "--target", str(target), str(wheel), cwd=source)
    # Kernels compiled by other tests are found by a copy of the library.
    if PACKAGE_CACHE.exists():
        place = target / "virtual_phantom" / PACKAGE_CACHE.relative_to(LIBRARY)
        shutil.copytree(PACKAGE_CACHE, place, ignore=shutil.ignore_patterns("*.tmp.*"))
    return target


def test_study_in_a_few_lines(installed, tmp_path):
    assert len([line for line in STUDY.splitlines() if line and not line.startswith(("import", "from"))]) <= 20
    (tmp_path / "study.py").write_text(STUDY)
    *rois, place = run(warm.python(), "study.py", cwd=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert Path(place).is_relative_to(installed)
    assert len(rois) == 6
    for name, measured, true in map(str.split, rois):
        assert float(measured) == pytest.approx(float(true), abs=25), name  # HU


def test_all_data_files_are_installed(installed):
    actual, theirs = (
        {
            str(path.relative_to(place))
            for path in place.rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        for place in (Path(virtual_phantom.__file__).parent, installed / "virtual_phantom")
    )
    assert {path for path in actual if not Path(path).name.startswith(".")} == theirs


def test_copy_of_the_library_has_its_kernels(installed, tmp_path):
    """Compiled kernels are found in a copy of their folder, for example of a project that was moved."""
    program = """
from virtual_phantom.projectors.kernels import tile_width
tile_width((0,) * 13)
print(sum(tile_width.stats.cache_hits.values()), sum(tile_width.stats.cache_misses.values()))
"""
    copy = tmp_path / "copy"
    first = run(sys.executable, "-c", program, cwd=tmp_path, PYTHONPATH=str(installed), NUMBA_CACHE_DIR="")
    shutil.copytree(installed, copy)
    again = run(sys.executable, "-c", program, cwd=tmp_path, PYTHONPATH=str(copy), NUMBA_CACHE_DIR="")
    assert (first.split(), again.split()) == (["0", "1"], ["1", "0"])


def test_imported_packages_are_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    declared = {re.match(r"[\w-]+", one)[0].lower() for one in stated}
    imported = set()
    for path in LIBRARY.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.Import):
                imported |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(node.module.split(".")[0])
    imported -= {*sys.stdlib_module_names, "virtual_phantom"}
    assert {"numpy", "vl_convert"} <= imported
    distributions = packages_distributions()
    unknown = {name for name in imported if declared.isdisjoint(one.lower() for one in distributions.get(name, [name]))}
    assert not unknown


def test_importer_is_a_command(installed, tmp_path):
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert set(scripts) == {"virtual-phantom", "virtual-phantom-import"}
    name = "virtual-phantom-import"
    geometry = {"distanceSourceOrigin": 410.66, "distanceSourceDetector": 553.74, "distanceUnit": "mm"}
    views = {"angles": [float(angle) for angle in range(0, 361, 30)], "numDetectorsPost": 112, "pixelSizePost": 1.0}
    sinogram = [[0.5] * 112 for _ in views["angles"]]
    content = {"type": "2d", "sinogram": sinogram, "parameters": {**geometry, **views}}
    savemat(tmp_path / "s.mat", {"CtDataFull": content})
    words = (warm.python(), str(installed / "bin" / name), "htc2022", "s.mat", "disc")
    assert "disc: projections, 1 repeat\n" in run(*words, cwd=tmp_path, PYTHONPATH=str(installed))
    assert (tmp_path / "disc" / "recording.yaml").exists()
