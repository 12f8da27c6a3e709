"""Checks of data whose object is not known, on scans of ellipses with a known fault."""

import numpy as np
import pytest

import virtual_phantom as vp
from virtual_phantom.base.data import SCHEMAS
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid
from virtual_phantom.diagnosis.setup.descriptions import descriptions
from virtual_phantom.diagnosis.setup.mismatch import Comparison
from virtual_phantom.io.schema import read_schema, validate
from virtual_phantom.io.volumes import Volume, write_nifti
from virtual_phantom.physics.scenes.shapes import DiscScene
from virtual_phantom.recordings.importers.projections import import_projections
from virtual_phantom.report.diagnosis import write_results

# x, y, half axes and rotation (mm, radians), attenuation (1/mm)
ELLIPSES = ((0, 0, 60, 40, 0.3, 0.02), (30, 10, 15, 8, 1.0, 0.03), (-40, -5, 10, 10, 0, -0.015))
FAN = {"source_to_axis": 500.0, "source_to_detector": 1000.0, "pixel": [2.3]}
VIEWS, COLUMNS = 180, 160


def chords(source, towards):
    """Line integrals through the ellipses from sources along directions, both (..., 2)."""
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    total = 0.0
    for x, y, long, short, turn, mu in ELLIPSES:
        rows = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) / [[long], [short]]
        start, along = (source - np.array([x, y])) @ rows.T, towards @ rows.T
        a, b, c = (along**2).sum(-1), (start * along).sum(-1), (start**2).sum(-1) - 1
        total = total + 2 * mu * np.sqrt(np.maximum(b * b - a * c, 0)) / a
    return total


def fan(shift=0.0, direction=1, views=VIEWS, turn_deg=360.0):
    angle = direction * np.radians(turn_deg) * np.arange(views)[:, None] / views
    across = (np.arange(COLUMNS) - (COLUMNS - 1) / 2 + shift) * FAN["pixel"][0]
    source = np.stack([-500 * np.sin(angle), 500 * np.cos(angle)], axis=-1)
    towards = np.stack(
        [1000 * np.sin(angle) + across * np.cos(angle), -1000 * np.cos(angle) + across * np.sin(angle)], axis=-1
    )
    return chords(source, towards)


def parallel(shift=0.0):
    angle = np.pi * np.arange(VIEWS)[:, None] / VIEWS
    across = (np.arange(COLUMNS) - (COLUMNS - 1) / 2 + shift) * 1.0
    column = np.stack([np.cos(angle) * across, np.sin(angle) * across], axis=-1)
    ray = np.stack([np.sin(angle), -np.cos(angle)], axis=-1) * np.ones_like(column)
    return chords(column, ray)


def diagnosed(folder, lines, noise=0.002, **options):
    """Diagnosis of line integrals, with its findings by subject."""
    random = np.random.default_rng(np.random.SeedSequence(1))
    if noise:
        lines = lines + noise * random.standard_normal(lines.shape)
    np.save(folder / "lines.npy", lines)
    options = {"angles": f"0,{360 / len(lines)}", "log": True} | (options or FAN)
    import_projections(folder / "lines.npy", folder / "scan", **options)
    found = vp.diagnose(folder / "scan", unknown=True)
    validate(found.content, read_schema(SCHEMAS / "diagnosis.schema.yaml"), "diagnosis.json")
    return found, {check["subject"]: check for check in found.content["data_checks"]}


def test_known_object_without_a_scale(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.ELLIPSES", ((3.0, -2.0, 50, 50, 0, 0.02),))
    np.save(tmp_path / "disc.npy", fan(shift=0.5, views=30))
    import_projections(tmp_path / "disc.npy", tmp_path / "disc", log=True, angles="0,12", unit="element", **FAN)
    options = {"alignment": {"scale": 1.0, "x_mm": 5.0, "y_mm": 5.0}, "effects": ["detector_offset"], "samples": 2}
    content = vp.diagnose(tmp_path / "disc", disc=(100.0, "pmma"), **options).content
    assert content["verdict_lines"][0].startswith("Not determined: spectrum, scatter and other effects")
    assert "element" in content["modelled"]["scan"] and "mm" not in content["modelled"]["scan"]
    assert any("state the pixel size" in line for line in content["caveats"])
    (offset,) = content["effects"]
    assert offset["parameters"]["columns_px"]["value"] == pytest.approx(0.5, abs=0.05)


def test_data_without_signal_are_refused_before_the_setup_is_checked(tmp_path):
    np.save(tmp_path / "empty.npy", np.zeros((30, COLUMNS)))
    import_projections(tmp_path / "empty.npy", tmp_path / "empty", log=True, angles="0,12", **FAN)
    with pytest.raises(InputError, match="100 % of the rays have no signal"):
        vp.diagnose(tmp_path / "empty", disc=(100.0, "pmma"))


def test_small_scanner_is_accepted_by_the_check_of_the_setup(tmp_path):
    np.save(tmp_path / "disc.npy", fan(views=30))
    small = {"source_to_axis": 25.0, "source_to_detector": 500.0, "pixel": [0.2]}
    options = {"log": True, "angles": "0,12", "not_checked": ["size"], **small}
    recording = import_projections(tmp_path / "disc.npy", tmp_path / "disc", **options)
    lines = recording.repeats[0].data[None]
    comparison = Comparison(DiscScene(1.0, "pmma"), lines, lines[0] > -1, (10, 1, 40), {}, None, ["size"])
    assert comparison.rays(next(descriptions(recording.scan, True, 1.0))).geometry.magnification == 20


def test_consistent_data_have_nothing_wrong(tmp_path):
    found, checks = diagnosed(tmp_path, fan())
    assert [subject for subject, check in checks.items() if check["wrong"]] == []
    assert found.content["verdict"] == "object not known" and found.content["effects"] == []
    first, *_, last = found.content["verdict_lines"]
    assert first == (
        "Missing physics: not determined, because the scanned object is not known and the tube voltage is not stated."
    )
    assert last.startswith("Next: state the object and its material")
    assert checks["noise"]["values"]["relative_sd"] == pytest.approx(0.002, rel=0.1)
    assert checks["geometry"]["values"]["distance"] == pytest.approx(1, abs=0.01)
    paths = {name: tmp_path / name for name in ("diagnosis", "physics", "report", "maps")}
    write_results(found, type("Paths", (), paths))
    assert "opposite rays" in paths["report"].read_text() and "Problems in the data" not in paths["report"].read_text()


def test_faults_of_a_fan_beam_are_found(tmp_path):
    lines = fan(shift=0.6)
    lines = lines / (1 + lines / 6) + 0.3
    lines[:, 41] = 0.0
    _, checks = diagnosed(tmp_path, lines)
    assert checks["air"]["values"]["level"] == pytest.approx(0.3, abs=0.002)
    assert checks["defective pixels"]["text"] == "1 defective column (41)"
    shift = checks["center of rotation"]["values"]
    assert shift["shift_px"] == pytest.approx(0.6, abs=4 * shift["error"]) and shift["error"] < 0.1
    assert checks["linearity"]["values"]["saturation"] == pytest.approx(6, rel=0.1)
    assert "beam hardening, scatter or both" in checks["linearity"]["text"]
    assert all(checks[name]["wrong"] for name in ("air", "defective pixels", "center of rotation", "linearity"))


def test_edges_of_a_centered_disc_are_no_defects(tmp_path, monkeypatch):
    """Both edges are in the same columns of all views, and 27 pixels span the radius."""
    monkeypatch.setattr(f"{__name__}.ELLIPSES", ((0.0, 0.0, 31.0, 31.0, 0, 0.02),))
    for name, defects in (("whole", []), ("defective", [75])):
        lines = fan(views=60)
        lines[:, defects] += 0.05
        (tmp_path / name).mkdir()
        _, checks = diagnosed(tmp_path / name, lines)
        found = checks["defective pixels"]["text"] if "defective pixels" in checks else None
        assert found == ("1 defective column (75)" if defects else None)


def test_other_direction_of_rotation(tmp_path):
    _, checks = diagnosed(tmp_path, fan(direction=-1))
    assert checks["geometry"]["wrong"] and "direction of rotation reversed" in checks["geometry"]["text"]


def test_change_within_the_scan(tmp_path):
    lines = fan(views=181, turn_deg=360 * 181 / 180)
    lines += 0.05 * np.linspace(0, 1, 181)[:, None] * (lines > 0)
    _, checks = diagnosed(tmp_path, lines, **FAN, angles="0,2")
    repeated = checks["repeated views"]
    assert repeated["wrong"] and "views 0 and 180" in repeated["text"]
    assert checks["linearity"]["wrong"] and "no saturation explains" in checks["linearity"]["text"]


def test_parallel_beam_over_half_a_turn(tmp_path):
    options = {"beam": "parallel", "angles": f"0,{180 / VIEWS}", "pixel": [0.7], "unit": "um", "energy_kev": 30.0}
    _, checks = diagnosed(tmp_path, parallel(shift=-0.4), **options)
    values = checks["center of rotation"]["values"]
    assert values["shift_px"] == pytest.approx(-0.4, abs=4 * values["error"])
    assert not checks["linearity"]["wrong"] and "geometry" not in checks


def test_photons_and_dark_signal_of_counts(tmp_path):
    random = np.random.default_rng(np.random.SeedSequence(2))
    data = random.poisson(5000 * np.exp(-fan())) + 200
    _, checks = diagnosed(tmp_path, data.astype(np.uint16), 0.0, **FAN, log=False, flat="5200", dark="200")
    assert checks["noise"]["values"]["photons_in_air"] == pytest.approx(5000, rel=0.1)
    assert checks["dark signal"]["values"]["dark"] == 200
    assert not any(check["wrong"] for check in checks.values())


def test_object_beyond_the_detector(tmp_path):
    _, checks = diagnosed(tmp_path, fan()[:, 50:110])
    assert checks["air"]["wrong"] and "no column sees air" in checks["air"]["text"]
    assert "linearity" not in checks


def test_images_with_few_levels(tmp_path):
    """Images saved with 256 gray values in a window from -45 to 105 HU."""
    random = np.random.default_rng(np.random.SeedSequence(3))
    exact = np.repeat(np.linspace(-1000, 200, 64)[:, None], 64, axis=1) + 20 * random.standard_normal((2, 64, 64))
    shown = np.rint((np.clip(exact, -45, 105) + 45) / 150 * 255) / 255 * 150 - 45
    for name, image in {"exact": exact, "window": shown}.items():
        (folder := tmp_path / name).mkdir()
        write_nifti(Volume(image.astype(np.float32), Grid(image.shape, (1, 1, 1))), folder / "one.nii.gz")
        content = "{name: it, kind: images, repeats: [one.nii.gz], not_checked: [hu, window]}"
        (folder / "recording.yaml").write_text(content)
    content = vp.diagnose(tmp_path / "window", unknown=True).content
    assert "not known and values were clipped" in content["verdict_lines"][0]
    texts = [check["text"] for check in content["data_checks"] if check["wrong"]]
    assert "levels: steps of 0.588 HU" in texts[0] and len(texts) == 3
    assert "are 105 HU, the largest one" in texts[1] and "are -45 HU, the smallest one" in texts[2]
    assert not any(check["wrong"] for check in vp.diagnose(tmp_path / "exact", unknown=True).content["data_checks"])
