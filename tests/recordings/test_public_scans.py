"""Public scans: the list, fetching from S3, user folders, and one line per error."""

import csv
import json
import os
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import public_files
import pydicom
import pytest
from s3_service import BUCKET, KINDS, service

from virtual_phantom.base.errors import InputError
from virtual_phantom.recordings.public_scans import fetch as fetching
from virtual_phantom.recordings.public_scans.fetch import check_scan, fetch_scan, link_scan
from virtual_phantom.recordings.public_scans.files import find_scans
from virtual_phantom.recordings.public_scans.table import public_scans, select_scans, small_subset

INDEX = Path(__file__).resolve().parents[2] / "../shared/real/printed_phantom_index"
TANDEM = "ct_phantom4radiomics"


# The list


def test_list_agrees_with_the_collections():
    """The counts and sizes stated on the collections' pages."""
    by = Counter(scan.collection for scan in public_scans())
    assert by == {TANDEM: 238, "ct4harmonization_multicentric": 1378}
    tandem = [scan for scan in public_scans() if scan.collection == TANDEM]
    assert Counter(scan.group for scan in tandem) == {"1": 29, "2": 29} | {str(group): 30 for group in range(3, 9)}
    assert round(sum(scan.megabytes for scan in tandem) / 1000, 1) == 42.5
    others = [scan for scan in public_scans() if scan.collection != TANDEM]
    assert round(sum(scan.megabytes for scan in others) / 1000) == 252
    facts = {(scan.group, scan.slice_mm, scan.kernel, scan.reconstruction, scan.ct.files) for scan in tandem}
    assert facts == {
        ("1", 2.0, "I30f", "ADMIRE3", 343),
        ("2", 2.0, "B30f", "FBP", 343),
        ("3", 1.5, "I30f", "ADMIRE3", 343),
        ("4", 1.5, "B30f", "FBP", 343),
        ("5", 3.0, "I30f", "ADMIRE3", 172),
        ("6", 3.0, "B30f", "FBP", 172),
        ("7", 1.0, "I26f", "ADMIRE3", 457),
        ("8", 1.0, "B26f", "FBP", 457),
    }


@pytest.mark.real
@pytest.mark.skipif(not INDEX.exists(), reason="the index of the collections is not beside this checkout")
@pytest.mark.parametrize("collection", [TANDEM, "ct4harmonization_multicentric"])
def test_every_series_of_the_index_is_listed_correctly(collection):
    actual = {series.uid: (scan, series) for scan in public_scans() for series in scan.series}
    with open(INDEX / f"{collection}.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) in (476, 2756)
    for row in rows:
        scan, series = actual[row["SeriesInstanceUID"]]
        assert (series.modality, series.folder) == (row["Modality"], row["crdc_series_uuid"])
        assert (scan.study, scan.collection) == (row["StudyInstanceUID"], collection)
        assert series.files == int(row["instanceCount"]) and series.megabytes == float(row["series_size_MB"])
        if series is scan.ct:
            assert (scan.description, scan.model) == (row["SeriesDescription"], row["ManufacturerModelName"])


def test_selection_returns_the_selected_scans():
    scans = select_scans({"collection": TANDEM, "groups": [1, "8"], "acquisitions": [1, 11, 12, 13, 14]}, "here")
    # Groups 1 and 2 count from the second acquisition.
    assert [scan.name for scan in scans] == ["110", "111", "112", "113", "801", "811", "812", "813", "814"]
    assert sorted(scan.name for scan in small_subset(scans)) == ["110", "111", "112", "801", "811", "812"]
    edge = {"collection": "ct4harmonization_multicentric", "groups": ["A1"], "dose_mgy": [1], "reconstruction": ["IR"]}
    assert len(select_scans(edge, "here")) == 10


@pytest.mark.parametrize(
    "key, value, message",
    [
        (
            "groups",
            [9],
            "config: here.groups has 9, which ct_phantom4radiomics does not have; choose from 1, 2, 3, 4, 5, 6, 7, 8",
        ),
        ("acquisitions", [31], "config: here.acquisitions has 31, .* choose from 1, 2, .*, 30$"),
        ("dose_mgy", [3], "config: here.dose_mgy has 3, .* choose from 10$"),
    ],
)
def test_selection_of_missing_scans_is_rejected(key, value, message):
    with pytest.raises(InputError, match=message):
        select_scans({"collection": TANDEM, key: value}, "here")


# Fetching


@pytest.fixture(scope="module", params=KINDS)
def running(request, tmp_path_factory):
    """Service with scans 801 and 802, and these scans."""
    folder = tmp_path_factory.mktemp("s3")
    scans = public_files.write_bucket(public_files.listed("801", "802"), folder / BUCKET)
    with service(request.param, folder) as one:
        one.begin()
        for scan in scans:
            for series in scan.series:
                one.put(series)
        yield one, scans


@pytest.fixture
def s3(running, monkeypatch):
    """The same with s5cmd in PATH."""
    for name, value in running[0].variables.items():
        monkeypatch.setenv(name, value)
    return running


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_scan_is_fetched_completely_with_its_license(s3, tmp_path):
    one, (scan, _) = s3
    target = tmp_path / "with blank" / "801"
    fetch_scan(scan, target, one.endpoint, BUCKET)
    assert len(files_in(target / "ct")) == 6 and len(files_in(target / "seg")) == 1
    for series in scan.series:
        for path in (one.folder / BUCKET / series.folder).iterdir():
            assert (target / series.modality.lower() / path.name).read_bytes() == path.read_bytes()
    check_scan(scan, target)
    source = json.loads((target / "source.json").read_text())
    assert (source["doi"], source["licence"]) == ("10.7937/a1v1-rc66", "CC BY 4.0")
    assert [of["uid"] for of in source["series"]] == [scan.ct.uid, scan.seg.uid]
    assert [path.name for path in target.parent.iterdir()] == ["801"]


def test_complete_scan_is_not_fetched_again(s3, tmp_path):
    one, (scan, _) = s3
    target, partial = tmp_path / "801", tmp_path / ".partial-801"
    fetch_scan(scan, target, one.endpoint, BUCKET)
    (target / "source.json").unlink()
    target.rename(partial)
    stored, lost, cut, *_ = sorted((partial / "ct").iterdir())
    os.utime(stored, (1e9, 1e9))
    lost.unlink()
    whole = cut.read_bytes()
    cut.write_bytes(whole[:200])
    (partial / "ct" / "x.dcm99").write_bytes(whole[:200])  # as a killed s5cmd leaves it
    fetch_scan(scan, target, one.endpoint, BUCKET)
    assert (target / "ct" / stored.name).stat().st_mtime == 1e9
    assert (target / "ct" / cut.name).read_bytes() == whole and len(files_in(target / "ct")) == 6


def refused(scan, target, endpoint, bucket=BUCKET):
    """The error line; no scan may appear as complete."""
    with pytest.raises(InputError) as error:
        fetch_scan(scan, target, endpoint, bucket)
    assert not target.exists() and "\n" not in str(error.value)
    return str(error.value)


def test_missing_service_or_bucket_is_one_line(s3, tmp_path):
    one, (scan, _) = s3
    text = refused(scan, tmp_path / "801", "http://localhost:9")
    assert "801: 0 of 7 files were downloaded (no connection)" in text and "run again to continue" in text
    assert "0 of 7 files were downloaded (" in refused(scan, tmp_path / "801", one.endpoint, "another-bucket")


def test_missing_series_leaves_the_others(s3, tmp_path):
    one, (scan, _) = s3
    missing = replace(scan, seg=replace(scan.seg, folder="00000000-0000-4000-8000-000000000000"))
    text = refused(missing, tmp_path / "801", one.endpoint)
    assert "801: 6 of 7 files were downloaded (no object found)" in text
    fetch_scan(scan, tmp_path / "801", one.endpoint, BUCKET)


@pytest.mark.parametrize("wrong", ["size", "count", "series", "doubled"])
def test_files_that_differ_from_the_list_are_rejected(s3, tmp_path, wrong):
    one, (scan, other) = s3
    text = {
        "size": "the files of its CT have 0.01 MB, but the list says 0.06 MB",
        "count": "6 of 7 files of its CT are present",
        "series": f"belongs to series {other.ct.uid}, not to {scan.ct.uid}",
        "doubled": "is the same slice as",
    }[wrong]
    if wrong == "size":
        listed = replace(scan, ct=replace(scan.ct, megabytes=0.06))
    elif wrong == "count":
        listed = replace(scan, ct=replace(scan.ct, files=7))
    elif wrong == "series":
        listed = replace(scan, ct=replace(scan.ct, folder=other.ct.folder))
    else:
        listed = scan
        partial = tmp_path / ".partial-801" / "ct"
        partial.mkdir(parents=True)
        first = min((one.folder / BUCKET / scan.ct.folder).iterdir())
        shutil.copy(first, partial / "again.dcm")
    line = refused(listed, tmp_path / "801", one.endpoint)
    assert text in line and ("delete" in line or "remove one" in line), line


def test_full_disk_is_reported_before_the_transfer(s3, tmp_path, monkeypatch):
    one, (scan, _) = s3
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(fetching.shutil, "disk_usage", lambda path: usage._replace(free=1000))
    assert "needs 0 MB, but only 0 MB are free" in refused(scan, tmp_path / "801", one.endpoint)
    assert files_in(tmp_path) == []


def test_missing_s5cmd_is_one_line_with_installation(tmp_path, monkeypatch):
    monkeypatch.setattr(fetching.shutil, "which", lambda *_, **__: None)
    text = refused(public_files.listed("801")[0], tmp_path / "801", "http://localhost:9")
    assert text.startswith("s5cmd: is not installed") and "make setup-fetch" in text
    assert not list(tmp_path.iterdir())


# User folders

LAYOUTS = {
    "idc": lambda scan, series, ds: f"{series.folder}/{ds.SOPInstanceUID[-12:]}.dcm",
    "nbia": lambda scan, series, ds: (
        f"manifest-1/{scan.collection}/{ds.PatientID}/02-21-2017-NA-Thorax-{scan.study[-5:]}/"
        f"{float(ds.SeriesNumber):f}-{scan.description}-{series.uid[-5:]}/1-{ds.InstanceNumber:03d}.dcm"
    ),
    "flat": lambda scan, series, ds: f"{ds.SOPInstanceUID[-12:]}",
}


def lay_out(scans, bucket, folder, layout):
    for scan in scans:
        for series in scan.series:
            for path in sorted((bucket / series.folder).iterdir()):
                ds = pydicom.dcmread(path, stop_before_pixels=True)
                place = folder / LAYOUTS[layout](scan, series, ds)
                place.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, place)
    (folder / "LICENSE").write_text("CC BY 4.0")
    (folder / "metadata.csv").write_text("a,b\n")


@pytest.fixture(scope="module")
def bucket(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bucket")
    return folder, public_files.write_bucket(public_files.listed("801", "802"), folder)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_folder_of_any_layout_is_read_by_tags(bucket, tmp_path, layout):
    folder, scans = bucket
    lay_out(scans, folder, tmp_path / "mine", layout)
    found = find_scans(tmp_path / "mine", scans)
    for scan in scans:
        link_scan(scan, found[scan.name], tmp_path / scan.name)
        check_scan(scan, tmp_path / scan.name)
        slices = [pydicom.dcmread(path) for path in (tmp_path / scan.name / "ct").iterdir()]
        assert {one.SeriesInstanceUID for one in slices} == {scan.ct.uid}
        assert len({one.SOPInstanceUID for one in slices}) == 6
        assert json.loads((tmp_path / scan.name / "source.json").read_text())["scan"] == scan.name


@pytest.mark.parametrize("wrong", ["missing", "half", "doubled", "broken", "no folder"])
def test_error_in_a_folder_is_one_line(bucket, tmp_path, wrong):
    folder, scans = bucket
    mine = tmp_path / "mine"
    lay_out(scans, folder, mine, "idc")
    first, *_ = sorted((mine / scans[0].ct.folder).iterdir())
    if wrong == "missing":
        shutil.rmtree(mine / scans[1].seg.folder)
        text = f"{mine}: 1 of 2 scans are missing (first: 802, {scans[1].description}, without SEG)"
    elif wrong == "half":
        first.unlink()
        text = f"{mine}: scan 801: 5 of 6 files of its CT are present; copy that series to"
    elif wrong == "doubled":
        again = mine / "zz" / "again.dcm"  # after the others
        again.parent.mkdir()
        shutil.copy(first, again)
        text = f"{again}: is the same slice as {first}; remove one of them"
    elif wrong == "broken":
        first.write_bytes(first.read_bytes()[:200])
        text = f"{first}: cannot be read as DICOM"
    else:
        mine = tmp_path / "elsewhere"
        text = f"downloads.scans: {mine}: no such folder"
    with pytest.raises(InputError) as error:
        find_scans(mine, scans)
    assert text in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", ["missing", "foreign", "doubled", "without regions", "cut off"])
def test_scan_damaged_after_the_transfer_is_one_line(bucket, tmp_path, wrong):
    """Jobs check before they read, so that no output is made from an incomplete scan."""
    folder, (scan, other) = bucket
    target = tmp_path / "801"
    for series in scan.series:
        shutil.copytree(folder / series.folder, target / series.modality.lower())
    check_scan(scan, target, sizes=False)
    first, *_ = sorted((target / "ct").iterdir())
    again = f"delete {target} and run snakemake fetch again"
    if wrong == "missing":
        first.unlink()
        text = f"{target}: 5 of 6 files of its CT are present; {again}"
    elif wrong == "foreign":
        stray = target / "ct" / "stray.dcm"
        shutil.copy(min((folder / other.ct.folder).iterdir()), stray)
        text = f"{stray}: belongs to series {other.ct.uid}, not to {scan.ct.uid}; {again}"
    elif wrong == "doubled":
        copy = target / "ct" / "zz.dcm"
        shutil.copy(first, copy)
        text = f"{copy}: is the same slice as {first}; remove one of them"
    elif wrong == "without regions":
        shutil.rmtree(target / "seg")
        text = f"{target}: 0 of 1 files of its SEG are present; {again}"
    else:
        first.write_bytes(first.read_bytes()[:200])
        text = f"{first}: cannot be read as DICOM"
    with pytest.raises(InputError) as error:
        check_scan(scan, target, sizes=False)
    assert str(error.value).startswith(text)
    assert "\n" not in str(error.value)
