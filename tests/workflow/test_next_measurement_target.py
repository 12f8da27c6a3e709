"""An ambiguous recording, and the recording that `snakemake next_measurement` suggests next."""

import json

import numpy as np
import pandas as pd
import pytest
import yaml
from simulated_scans import SCAN
from workflow_runs import snakemake

from virtual_phantom.io.exchange import write_line_integrals
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import Pose
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.document import read_document
from virtual_phantom.recordings.scan import scan_geometry


@pytest.fixture(scope="module")
def ranked(tmp_path_factory):
    """Folder of the ranking for a disc scanned by a shifted detector."""
    folder = tmp_path_factory.mktemp("next")
    (folder / "disc").mkdir()
    geometry = scan_geometry(SCAN, "scan")
    chain = Chain(DiscScene(160.0, "water"), geometry, 1e5, samples=2)
    state, random = chain.state({"detector_offset": {"columns_px": 0.15}}, Pose(x_mm=0.4, y_mm=-0.3)), np.random
    random = random.default_rng(5)
    names = [f"repeat_{number}.h5" for number in range(4)]
    for name in names:
        lines = -np.log(np.maximum(state.counts(random), 0.5) / (state.measured_air * state.photons))
        write_line_integrals(folder / "disc" / name, lines, geometry)
    content = {"name": "disc", "kind": "projections", "repeats": names, "scan": SCAN}
    (folder / "disc" / "recording.yaml").write_text(yaml.safe_dump(content))
    settings = {
        "disc": {"diameter_mm": 160, "material": "water"},
        "effects": ["detector_offset", "centre_of_rotation", "electronic_noise"],
        "samples": 1,
    }
    overlay = {
        "results_dir": str(folder / "results"),
        "recordings": {"disc": str(folder / "disc")},
        "diagnosis": {"recordings": {"disc": settings}, "matters": None},
    }
    (folder / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    process = snakemake("next_measurement", "--configfile", "config/tiny.yaml", folder / "overlay.yaml")
    assert process.returncode == 0, process.stderr[-3000:]
    return folder / "results" / "diagnosis" / "disc", process.stdout + process.stderr


def test_diagnosis_points_to_the_ranking(ranked):
    folder, _ = ranked
    found = json.loads((folder / "diagnosis.json").read_text())
    assert [effect["name"] for effect in found["effects"]] in (["detector_offset"], ["centre_of_rotation"]), found[
        "sentence"
    ]
    (line,) = found["next_measurement"]
    assert "snakemake next_measurement" in line and line in (folder / "report.html").read_text()


def test_table_figure_and_recording_exist(ranked):
    folder, printed = ranked
    table = pd.read_csv(folder / "next_measurement" / "ranking.csv")
    first = table.iloc[1]
    assert first["name"] == "less_magnified" and first["settles"] and not table.iloc[0]["settles"]
    assert first["recording"] in printed
    further = table.iloc[1:]
    settling = further["settles"].astype(bool)
    assert (settling.cummin() == settling).all()  # scans that leave a pair ambiguous come last
    for part in (further[settling], further[~settling]):
        assert (np.diff(part["information_gain_nats"]) <= 0).all()
    for name in ("ranking.png", "ranking.pdf"):
        assert (folder / "next_measurement" / name).stat().st_size > 1000
    ambiguous = pd.read_csv(folder / "next_measurement" / "effect_correlations.csv")
    assert set(ambiguous.iloc[0][["effect", "other"]]) == {"detector_offset", "centre_of_rotation"}
    assert ambiguous.iloc[0]["together"] > 0.95


def test_recording_template_is_valid(ranked):
    folder, _ = ranked
    path = folder / "next_measurement" / "recording.yaml"
    content = yaml.safe_load(path.read_text())
    for name in content["repeats"]:
        (path.parent / name).write_bytes(b"")
    filled = read_document(path.parent).content
    assert filled["name"] == "disc_less_magnified" and filled["scan"]["source_to_isocentre_mm"] > 500
    assert "scanners" in path.read_text()
