"""Full disks and read-only folders: one clear line, and no file that the next run would trust."""

import os
import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.io import exchange, files
from virtual_phantom.io.volumes import Volume, write_nifti

SIZE_KB = 256


def mounted(folder: Path, options: str) -> None:
    """Mount a small file system on `folder`; skips if mounting is not allowed."""
    if shutil.which("mount") is None:
        pytest.skip("there is no mount")
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    process = subprocess.run(command, capture_output=True, text=True)
    if process.returncode:
        pytest.skip(f"no file system may be mounted here: {process.stderr.strip()}")


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted(folder, f"size={SIZE_KB}k")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


RANDOM = np.random.default_rng(0)
GRID = Grid((40, 64, 64), (1.0, 1.0, 1.0))
NOISE = RANDOM.normal(size=GRID.shape).astype(np.float32)  # 640 kB of incompressible data
GEOMETRY = circular(
    views=40,
    source_to_isocentre_mm=500.0,
    source_to_detector_mm=1000.0,
    columns=64,
    rows=64,
    column_pitch_mm=1.0,
    row_pitch_mm=1.0,
)


def write_map(path):
    with files.replacing(path) as temporary, temporary.open("wb") as file:
        np.save(file, NOISE)


WRITERS = {
    "image.nii.gz": lambda path: write_nifti(Volume(NOISE, GRID), path),
    "image.nii": lambda path: write_nifti(Volume(NOISE, GRID), path),
    "clean.h5": lambda path: exchange.write_line_integrals(path, NOISE, GEOMETRY),
    "map.npy": lambda path: write_map(path),
    "table.csv": lambda path: files.write_csv(pd.DataFrame({"x": NOISE.ravel()}), path),
    "text.json": lambda path: files.write_text("x" * 10**6, path),
}


@pytest.mark.parametrize("name", WRITERS)
def test_full_disk_is_reported_and_the_old_file_remains(name, small_disk):
    path = small_disk / name
    files.write_text("old", path)
    with pytest.raises(InputError) as error:
        WRITERS[name](path)
    assert str(error.value) == f"{path}: cannot be written: the disk is full; free some space and run again"
    assert files.read_text(path) == "old"
    assert sorted(path.name for path in small_disk.iterdir()) == [f".{name}.sha256", name]


def test_disk_with_no_space_for_the_checksum(small_disk):
    """The file fits exactly: it must not appear without its checksum."""
    free = os.statvfs(small_disk).f_bavail * os.statvfs(small_disk).f_frsize
    with pytest.raises(InputError, match="the disk is full"):
        files.write_text("x" * free, small_disk / "a.txt")
    assert not list(small_disk.iterdir())


@pytest.mark.parametrize("name", WRITERS)
def test_read_only_file_system_is_reported(name, tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted(folder, f"size={SIZE_KB}k,ro")
    try:
        with pytest.raises(InputError, match="read-only; set another results_dir") as error:
            WRITERS[name](folder / "new" / name)
        assert "\n" not in str(error.value)
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folder_without_permission_is_reported(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(InputError, match="the folder may not be written to"):
        files.write_text("x", tmp_path / "a.txt")
    tmp_path.chmod(0o755)


def test_other_errors_of_writers_are_unchanged(tmp_path):
    """A programming error must not be reported as a disk error."""
    with pytest.raises(OSError) as error, files.replacing(tmp_path / "a.h5") as temporary:
        with h5py.File(temporary, "w") as file:
            file["x"] = np.zeros(3)
            file["x"] = np.zeros(3)
    assert not isinstance(error.value, InputError)
    assert not list(tmp_path.iterdir())
