"""Projection recordings: values, and files that contradict recording.yaml."""

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recording_folders import (
    SCAN,
    angles_deg,
    changed,
    line_integrals,
    projections_folder,
    refused,
    write_projections,
    write_yaml,
)

from virtual_phantom.base.errors import InputError
from virtual_phantom.diagnosis.preparation import prepare_recording
from virtual_phantom.diagnosis.request import DiagnosisRequest
from virtual_phantom.diagnosis.settings import Disc, RecordingSettings
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.recordings.projections import Projections
from virtual_phantom.recordings.reading import load_recording
from virtual_phantom.recordings.scan import coverage_note
from virtual_phantom.recordings.summary import summarize_recording

SHAPE = (SCAN["views"], SCAN["rows"], SCAN["columns"])


@pytest.mark.parametrize("log", [True, False])
def test_both_storage_formats_give_the_same_line_integrals(tmp_path, log):
    recording = load_recording(projections_folder(tmp_path / "r", log)[0])
    assert (len(recording.repeats), len(recording.held_out), recording.log) == (2, 1, log)
    for acquisition in (*recording.repeats, *recording.held_out):
        np.testing.assert_allclose(acquisition.line_integrals(1e-6), line_integrals(), atol=1e-5)
    assert recording.geometry.views == 24 and recording.notes == ()


def test_files_of_the_workflow_can_be_recordings(tmp_path):
    from virtual_phantom.io import exchange
    from virtual_phantom.recordings.scan import scan_geometry

    write_yaml(tmp_path, {"name": "own", "kind": "projections", "scan": SCAN, "repeats": ["clean.h5"]})
    exchange.write_line_integrals(tmp_path / "clean.h5", line_integrals(), scan_geometry(SCAN, "own"))
    np.testing.assert_array_equal(load_recording(tmp_path).repeats[0].data, line_integrals())


@pytest.mark.parametrize("share", [0.2, 0.6, 0.98])
@pytest.mark.parametrize("log", [True, False])
def test_truncated_file_is_named(tmp_path, log, share):
    folder, _ = projections_folder(tmp_path / "r", log)
    whole = (folder / "b.h5").read_bytes()
    (folder / "b.h5").write_bytes(whole[: int(share * len(whole))])
    refused(folder, "b.h5: not a complete")


FRAME = np.full(SHAPE[1:], 1000.0)


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"data_white": None}, "b.h5: has no /exchange/data_white, which counts need"),
        ({"data_dark": None}, "b.h5: has no /exchange/data_dark"),
        ({"data": None}, "b.h5: has no /exchange/data;"),
        ({"data": np.ones((23, 4, 40))}, "b.h5: has 23 views, but recording.yaml says scan.views 24"),
        ({"data": np.ones((24, 5, 40))}, "b.h5: has 5 rows, but recording.yaml says scan.rows 4"),
        ({"data": np.ones((24, 4, 41))}, "b.h5: has 41 columns"),
        ({"data": np.ones((24, 40))}, "has 2 dimensions"),
        ({"theta": np.arange(23.0)}, "has 23 angles for 24 views"),
        ({"theta": np.deg2rad(angles_deg())}, "/exchange/theta of view"),
        ({"theta": angles_deg(SCAN | {"direction": 1})}, "/exchange/theta of view"),
        ({"theta": np.full(24, np.nan)}, "/exchange/theta of view"),
        ({"theta": np.float64(15.0)}, "has 1 angles for 24 views"),
        ({"theta": np.tile(angles_deg(), (2, 1))}, "/exchange/theta has the shape (2, 24); store one angle per view"),
        ({"theta": np.array([b"0"] * 24)}, "/exchange/theta has type |S1; store one angle per view"),
        ({"data_white": FRAME[:, :-1]}, "/exchange/data_white has shape (4, 39), but the projections have (4, 40)"),
        (
            {"data_white": np.full((1, 4, 40), 20.0)},
            "white field does not exceed the dark field in 100 % of the pixels",
        ),
        ({"data_white": FRAME * np.nan}, "/exchange/data_white contains NaN"),
        ({"data": np.full(SHAPE, np.inf)}, f"{np.prod(SHAPE)} counts are NaN or infinite"),
        ({"data": np.full(SHAPE, 5000.0)}, "the median count is over twice the white field"),
        ({"data": np.full(SHAPE, 50.5)}, "the largest count is 0.5 above the dark field, the white field 950"),
        ({"data_dark": np.zeros((0, 4, 40))}, "/exchange/data_dark has no frames; store the measured field, or zeros"),
    ],
)
def test_impossible_counts_are_rejected(tmp_path, changes, message):
    refused(projections_folder(tmp_path / "r", **changes)[0], message)


@pytest.mark.parametrize(
    "data, message",
    [
        (np.full(SHAPE, 40000.0), "line integrals reach 40000; if these are counts"),
        (-line_integrals(), "the mean line integral is negative"),
        (np.full(SHAPE, np.nan), "are NaN or infinite"),
    ],
)
def test_impossible_line_integrals_are_rejected(tmp_path, data, message):
    refused(projections_folder(tmp_path / "r", True, data=data)[0], message)


def test_counts_of_the_astra_noise_model_are_rejected(tmp_path):
    folder, _ = projections_folder(tmp_path / "r")
    with h5py.File(folder / "b.h5", "a") as file:
        file["exchange/data"].attrs["line_integral_scale"] = 2.0
    refused(folder, "noise.model astra")


@pytest.mark.parametrize("value, message", [("false", None), (b"False", None), ("perhaps", "is 'perhaps'; set it to")])
def test_flag_stored_as_text(tmp_path, value, message):
    folder, _ = projections_folder(tmp_path / "r")
    with h5py.File(folder / "b.h5", "a") as file:
        file["exchange/data"].attrs["log"] = value
    if message:
        refused(folder, message)
    else:
        assert not load_recording(folder).log


def test_counts_with_line_integrals_are_rejected(tmp_path):
    folder, _ = projections_folder(tmp_path / "r")
    write_projections(folder / "b.h5", log=True)
    refused(folder, "b.h5: contains line integrals, but a.h5 contains counts")


def test_dead_pixels_and_missing_theta_are_reported(tmp_path):
    white = np.full((1, *SHAPE[1:]), 1000.0)
    white[0, 2, 7] = 50.0
    folder, _ = projections_folder(tmp_path / "r", data_white=white, theta=None)
    recording = load_recording(folder)
    assert any("b.h5: 1 dead pixel (" in note for note in recording.notes)
    assert any("b.h5: no /exchange/theta" in note for note in recording.notes)
    values = recording.repeats[1].line_integrals(1e-6)
    assert np.isnan(values[:, 2, 7]).all() and np.isnan(values).sum() == SHAPE[0]


def test_counts_below_the_dark_field_are_reported(tmp_path):
    data = np.full(SHAPE, 500.0)
    data[::2] = 50.0
    folder, _ = projections_folder(tmp_path / "r", data=data)
    assert any(note == "b.h5: 50 % of the counts do not exceed the dark field" for note in load_recording(folder).notes)


def test_views_over_less_than_half_a_turn_are_reported():
    steps = np.radians(np.arange(24) / 24)
    assert coverage_note({}, 180 * steps) is None
    assert coverage_note({}, -15 * steps).startswith("the views cover 15 degrees, less than half a turn;")
    assert coverage_note({"angles_deg": "unknown"}, np.zeros(24)) is None


def test_views_beyond_a_turn_are_reported(tmp_path):
    folder, content = projections_folder(tmp_path / "r")
    scan = SCAN | {"views": 25}
    for name in "abc":
        write_projections(folder / f"{name}.h5", scan=scan)
    assert (
        load_recording(write_yaml(folder, content | {"scan": scan}))
        .notes[0]
        .startswith("1 view beyond the first rotation")
    )


@given(arrays(np.float64, (2, 1, 3), elements=st.floats(-10, 2000)), st.floats(1, 100), st.floats(1e-6, 0.1))
def test_line_integrals_are_finite_and_decrease_with_the_counts(data, dark, smallest):
    white = np.full((1, 3), dark + 500.0)
    values = Projections(data, white, np.full((1, 3), dark)).line_integrals(smallest)
    assert np.isfinite(values).all() and values.max() <= -np.log(smallest) + 1e-5
    more = Projections(data + 50, white, np.full((1, 3), dark)).line_integrals(smallest)
    assert (more <= values).all()


def test_summary_lists_what_is_missing(tmp_path):
    folder, content = projections_folder(tmp_path / "r")
    found = summarize_recording(load_recording(folder))
    assert (found["repeats"], found["held_out"], found["content"]["shape"]) == (2, 1, list(SHAPE))
    assert found["content"]["values"] == "counts" and set(found["sha256"]) == {"recording.yaml", "a.h5", "b.h5", "c.h5"}
    assert found["missing"] == ["nominal.tube_kvp", "nominal.anode", "nominal.filtration", "nominal.sensor"]
    content = changed(content, "repeats", ["a.h5"]) | {"phantom": "synthetic", "nominal": {"tube_kvp": 80}}
    missing = summarize_recording(load_recording(write_yaml(folder, content)))["missing"]
    assert missing == [
        "a second repeat (with one repeat, the noise is not known)",
        "nominal.anode",
        "nominal.filtration",
        "nominal.sensor",
    ]


def test_stated_sensor_is_used_in_the_model(tmp_path):
    """Unstated values are typical, and the thickness is freer the less is stated."""
    settings = RecordingSettings(samples=1, view_step=1, alignment={}, disc=Disc(20.0, "water"))
    folder, content = projections_folder(tmp_path / "r", log=True)
    random = np.random.default_rng(1)
    for name in "abc":
        noisy = line_integrals(SCAN) + random.normal(0, 0.01, SHAPE)
        write_projections(folder / f"{name}.h5", log=True, data=noisy.astype(np.float32))
    for output, right in (
        ({}, ("caesium_iodide", "energy", 0.6, 1.0)),
        ({"material": "silicon", "reads": "counts"}, ("silicon", "counts", 30.0, 0.5)),
        ({"material": "caesium_iodide", "thickness_mm": 0.4}, ("caesium_iodide", "energy", 0.4, 0.05)),
    ):
        write_yaml(folder, content | {"nominal": {"sensor": output} if output else {}})
        _, prepared = prepare_recording(DiagnosisRequest(folder, settings, 0.0193, Segmentation()))
        sensor = prepared.fitter.model.chain.sensor
        assert (sensor.material, sensor.reads, sensor.thickness_mm, sensor.thickness_sd) == right
    write_yaml(folder, content | {"nominal": {"sensor": {"thickness_mm": 0.4}}})
    with pytest.raises(InputError, match="nominal.sensor"):
        load_recording(folder)


@pytest.mark.parametrize(
    "theta, units",
    [
        (angles_deg()[:, None], None),
        (angles_deg()[None], "degree"),
        (angles_deg().astype(np.int64), b"deg"),
        (np.deg2rad(angles_deg())[:, None].astype(np.float32), np.array([b"Radians"])),
    ],
)
def test_angles_are_read_as_a_row_or_a_column_in_the_stated_units(tmp_path, theta, units):
    folder, content = projections_folder(tmp_path / "r", theta=theta)
    if units is not None:
        with h5py.File(folder / "b.h5", "a") as file:
            file["exchange/theta"].attrs["units"] = units
    geometry = load_recording(folder).geometry
    assert np.rad2deg(geometry.angles_rad) == pytest.approx(angles_deg())


def test_angles_in_unknown_units_are_rejected(tmp_path):
    folder, _ = projections_folder(tmp_path / "r", theta=angles_deg())
    with h5py.File(folder / "b.h5", "a") as file:
        file["exchange/theta"].attrs["units"] = "steps"
    refused(folder, "the attribute units of /exchange/theta is 'steps'; use degrees or radians")
