"""`snakemake fetch`: public scans from a local service, resumed, in a dry run, or from a user folder."""

import json
import re
import shutil
import sys

import public_files
import pytest
import yaml
from pages import copy_project
from s3_service import BUCKET, KINDS, service
from workflow_runs import ROOT, snakemake

TABLE = "workflow/lib/virtual_phantom/resources/public_scans.csv"
NAMES = ("801", "802", "811")
PLACE = "resources/printed_phantom"
TANDEM = "ct_phantom4radiomics"
SCANS = {
    "phantom": {"collection": TANDEM, "groups": [8], "acquisitions": [1, 2]},
    "compared": {"collection": TANDEM, "groups": [8], "acquisitions": [11]},
}


@pytest.fixture(params=KINDS)
def setting(request, tmp_path):
    """A copy of the project whose list has small scans, and a service that has them."""
    project, folder = tmp_path / "project", tmp_path / "s3"
    copy_project(ROOT, project)
    scans = public_files.write_bucket(public_files.listed(*NAMES), folder / BUCKET)
    public_files.write_table(scans, project / TABLE)
    with service(request.param, folder) as one:
        one.begin()
        for scan in scans:
            for series in scan.series:
                one.put(series)
        yield project, one, scans


def fetch(project, *arguments, environment=None, scans=SCANS, own=None, **downloads):
    """Run `snakemake fetch`; returns its exit code, output and errors."""
    downloads["scans"] = own
    (project / "mine.yaml").write_text(
        yaml.safe_dump({"public_scans": scans, "downloads": downloads, "results_dir": "results"})
    )
    process = snakemake(
        "fetch", *arguments, "--configfile", "mine.yaml", project=project, environment=environment, cores=1
    )
    output = process.stdout + process.stderr
    assert "Traceback" not in output, output[-3000:]
    return process.returncode, output, [line for line in output.splitlines() if line.startswith("Error:")]


def here(project):
    folder = project / PLACE
    return sorted(path.name for path in folder.iterdir()) if folder.exists() else []


def test_scans_are_listed_fetched_and_not_fetched_again(setting):
    project, one, scans = setting
    variables = one.variables | {"STOP_AFTER": "4"}
    code, output, _ = fetch(project, "-n", endpoint="http://localhost:9")  # no network
    assert code == 0 and not here(project)
    size = sum(scan.megabytes for scan in scans) / 1000
    assert f"3 CT and 3 SEG series, 21 files, {size:.1f} GB to be fetched to {PLACE}" in output
    for scan in scans:
        assert scan.ct.uid in output and scan.seg.uid in output

    if "BUCKETS" in variables:
        code, output, errors = fetch(project, endpoint=one.endpoint, environment=variables)
        assert code == 1 and "run again to continue" in errors[0]
    else:
        code, output, errors = fetch(project, endpoint=one.endpoint, bucket="another-bucket", environment=variables)
        assert code == 1 and "0 of 7 files were downloaded" in errors[0]
    assert not set(here(project)) & set(NAMES) or all(
        (project / PLACE / name / "source.json").exists() for name in here(project) if name in NAMES
    )

    code, output, _ = fetch(project, endpoint=one.endpoint, environment=one.variables)
    assert code == 0, output[-3000:]
    assert here(project) == sorted(NAMES)
    for scan in scans:
        folder = project / PLACE / scan.name
        assert json.loads((folder / "source.json").read_text())["doi"] == "10.7937/a1v1-rc66"
        assert len(list((folder / "ct").glob("*.dcm"))) == scan.ct.files
    code, output, _ = fetch(project, "-n", endpoint="http://localhost:9")
    assert code == 0 and "Nothing to be done" in output and "to be fetched" not in output


@pytest.fixture
def alone(tmp_path):
    """A copy of the project, and a folder with the small scans of its list."""
    project, folder = tmp_path / "project", tmp_path / "mine"
    copy_project(ROOT, project)
    scans = public_files.write_bucket(public_files.listed(*NAMES), folder)
    public_files.write_table(scans, project / TABLE)
    return project, folder, scans


def test_user_folder_is_used_unchanged(alone):
    project, folder, scans = alone
    hidden = folder / scans[2].seg.folder
    hidden.rename(folder.parent / "away")
    code, output, errors = fetch(project, own=str(folder))
    assert code == 1 and here(project) == []
    assert errors[0].startswith(f"Error: downloads.scans: {folder}: 1 of 3 scans are missing (first: 811")
    (folder.parent / "away").rename(hidden)
    code, output, _ = fetch(project, own=str(folder))
    assert code == 0 and here(project) == sorted(NAMES), output[-3000:]
    slices = sorted((project / PLACE / "801" / "ct").iterdir())
    assert len(slices) == 6 and all(path.is_symlink() and path.exists() for path in slices)


def test_temporary_scans_leave_their_features(alone, tmp_path):
    project, folder, _ = alone
    programs = tmp_path / "one"
    selection = {"phantom": None, "compared": SCANS["compared"] | {"acquisitions": [1, 2, 11]}}
    settings = {"keep_scans": False, "public_scans": selection, "phantom": {"source": "synthetic"}}
    with service("stand_in", programs) as one:
        shutil.copytree(folder, programs / BUCKET)
        settings |= {"downloads": {"endpoint": one.endpoint}, "results_dir": "results"}
        (project / "mine.yaml").write_text(yaml.safe_dump(settings))
        files = ("--configfile", "config/printed_phantom.yaml", "mine.yaml")

        def run(target, *arguments):
            process = snakemake(target, *arguments, *files, project=project, environment=one.variables, cores=1)
            return process.returncode, process.stdout + process.stderr

        code, output = run("fetch", "-n")
        assert code == 1 and "Error: config: keep_scans is false, so the study fetches each scan when" in output
        code, output = run("public_features")
        assert code == 0, output[-3000:]
        assert "each scan is deleted after use" in output and here(project) == []
        for name in ("compared", "compared_2d"):
            lines = (project / f"results/public_scans/{name}/features.csv").read_text().splitlines()
            assert len(lines) == 1 + 3 * 6
        code, output = run("public_features", "-n")
        assert code == 0 and "Nothing to be done" in output and "to be fetched" not in output


def test_missing_s5cmd_is_one_line_with_installation(alone, tmp_path):
    project, _, _ = alone
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "python").symlink_to(sys.executable)
    for name in ("bash", "sh", "env"):
        (programs / name).symlink_to(shutil.which(name))
    code, output, errors = fetch(project, environment={"PATH": str(programs)})
    if "is not installed" not in output:
        pytest.skip("s5cmd is installed beside this Python")
    assert code == 1 and re.match("Error: s5cmd: is not installed, .*make setup-fetch", errors[0])
    assert here(project) == []


def test_study_without_public_scans_states_where_to_find_them(alone):
    project, _, _ = alone
    code, _, errors = fetch(project, "-n", scans={})
    assert code == 1 and len(errors) == 1
    assert errors[0].startswith("Error: config: public_scans is empty") and "config/printed_phantom.yaml" in errors[0]


def test_dry_run_of_the_first_collection_has_its_counts(tmp_path):
    """Numbers of the collection's page: 238 scans, groups 1 and 2 without their first."""
    (tmp_path / "all.yaml").write_text(yaml.safe_dump({"public_scans": {"compared": {"collection": TANDEM}}}))
    process = snakemake("fetch", "-n", "--configfile", tmp_path / "all.yaml")
    output = process.stdout + process.stderr
    assert process.returncode == 0, output[-2000:]
    assert "238 CT and 238 SEG series, 78452 files, 42.5 GB to be fetched" in output
    for group, scans, size in ((1, 29, 5.4), (2, 29, 5.4), (5, 30, 2.8), (8, 30, 7.4)):
        assert re.search(rf"{TANDEM}, {group}: {scans} CT and {scans} SEG series, \d+ files, {size} GB", output), group
    process = snakemake("fetch", "-n", "--configfile", "config/printed_phantom.yaml", "--config", "subset=small")
    assert "34 CT and 34 SEG series, 12494 files, 6.8 GB to be fetched" in process.stdout + process.stderr
