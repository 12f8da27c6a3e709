"""A copy of the project with a clinical CT of a few bytes, listed like the real one."""

import csv
import hashlib

from pages import copy_project
from workflow_runs import ROOT

from virtual_phantom.io.published import FOLDER

TABLE = "workflow/lib/virtual_phantom/resources/abdomen_ct.csv"


def copy_with_bytes(project):
    """Copy the project; its table lists the first two slices and the regions with other bytes.

    Returns the files of a web folder, {source: bytes}, and their paths, {path: source}.
    """
    copy_project(ROOT, project)
    with open(ROOT / TABLE, newline="") as file:
        rows = list(csv.DictReader(file))
    rows = [*rows[:2], rows[-1]]
    published = {row["source"]: f"bytes of {row['source']}".encode() for row in rows}
    for row in rows:
        row["sha256"] = hashlib.sha256(published[row["source"]]).hexdigest()
    with open(project / TABLE, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return published, {f"{FOLDER}/{row['file']}": row["source"] for row in rows}


def put(folder, files):
    """Write {path: bytes} below a folder."""
    for path, content in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)


def with_its_ct(project):
    """A copy of the project with the files at their paths."""
    published, places = copy_with_bytes(project)
    put(project, {path: published[source] for path, source in places.items()})
    return project
