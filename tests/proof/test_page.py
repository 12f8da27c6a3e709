"""The page of the blind validation and the job that makes it."""

import base64
import io
import json
import runpy
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from proof_suite import DIAGNOSES, TRUTHS, diagnosis, judged, truth, write_suite

from virtual_phantom.base.errors import InputError
from virtual_phantom.figures.before_after import thumbnail
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.hiding.hidden_effect import EQUATIONS
from virtual_phantom.proof.hiding.suite import check_recordings
from virtual_phantom.proof.scoring.collect import collect
from virtual_phantom.proof.scoring.example import example, in_words, residual_maps
from virtual_phantom.proof.scoring.real import minutes, row
from virtual_phantom.proof.scoring.registration import registration
from virtual_phantom.proof.scoring.rule import VERSION
from virtual_phantom.proof.scoring.score import score
from virtual_phantom.report.proof import blind_validation_page, percent

ROOT = Path(__file__).resolve().parents[2]


class Given(dict):
    """Snakemake's lists of named files."""

    __getattr__ = dict.__getitem__


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Outputs of the script for the suite of nine cases."""
    folder = tmp_path_factory.mktemp("suite")
    inputs = Given(write_suite(folder), maps=[folder / "diagnosis" / truth["case"] / "maps" for truth in TRUTHS])
    registered = registration({"seed": 4711}, TRUTHS, inputs["seals"])
    seal.write(registered, folder / "registration.json")
    inputs |= {"real": [], "real_maps": [], "times": [], "registration": folder / "registration.json"}
    names = ("confusion_png", "confusion_pdf", "example_png", "example_pdf")
    output = Given({name: folder / name.replace("_", ".") for name in names})
    output |= {"score": folder / "score.json", "page": folder / "index.html"}
    output["runs"] = folder / "runs.jsonl"
    params = Given(suite={"seed": 4711}, registered={"seed": 4711}, runs=output["runs"])
    snakemake = SimpleNamespace(input=inputs, output=Given(output), params=params, log=[folder / "log"], threads=1)
    runpy.run_path(str(ROOT / "workflow/scripts/score_proof.py"), {"snakemake": snakemake})
    return output


def test_job_writes_everything(made):
    assert len(json.loads(made["score"].read_text())["cases"]) == 9
    for name in ("confusion_png", "example_png"):
        assert made[name].read_bytes().startswith(b"\x89PNG")
    for name in ("confusion_pdf", "example_pdf"):
        assert made[name].read_bytes().startswith(b"%PDF")


def test_page_shows_the_registration_and_the_origin_of_the_models(made):
    text = " ".join(made["page"].read_text().replace("\N{NO-BREAK SPACE}", " ").split())
    assert "Number of starts: 0." in text
    assert (
        "This run does not count: its seed was chosen" in text and f"seed 4711, 9 cases, scoring rule {VERSION}" in text
    )
    assert '"event": "scored"' in made["runs"].read_text()
    never = (
        "contrast dependent resolution, crescent, current along z, detector roll, detector skew, detector tilt, "
        "resampling, residual cupping, rings, slice thickness, slow afterglow, truncation, water correction."
    )
    assert (
        f"never hidden, and therefore not tested: anti scatter grid, {never}" in text
        and "shares no physics" not in text
    )
    assert all(source in unescape(text) for source in EQUATIONS.values())
    assert "tenth percentile" in text and "53 %" in text  # for wrong names


def test_page_has_every_case_with_its_pictures_and_report(made):
    text = made["page"].read_text()
    for sealed in TRUTHS:
        assert f'id="{sealed["case"]}"' in text
        assert f'href="diagnosis/{sealed["case"]}/report.html"' in text
    assert text.count("data:image/png;base64,") == 1 + 2 * len(TRUTHS)
    assert "http" not in text


def test_page_escapes_its_text(made):
    text = made["page"].read_text()
    assert "left &lt;b&gt;over&lt;/b&gt; &amp; more" in text and "<b>over" not in text


def test_names_of_hidden_effects_and_cases_are_escaped():
    case = judged(truth("<i>", "unknown", {"!<script>": {}}), diagnosis("<i>", "unexplained"))
    blank = np.zeros((2, 2))
    text = blind_validation_page(score([case]), {"<i>": (blank, blank)}, {"<i>": '"><script>'})
    assert "<script>" not in text and "<i>" not in text and "&lt;script&gt;" in text


def test_missing_tables_and_untested_domains_are_reported(made):
    text = made["page"].read_text()
    assert "<strong>Without a held-out protocol:</strong> case_03" in text
    assert text.count("There is no table of agreement on another protocol.") == len(TRUTHS) - 2
    assert "Domains that no diagnosis tested:\nrows." in text


def test_case_without_maps_is_rejected(tmp_path):
    cases = collect(**write_suite(tmp_path, TRUTHS[:1], DIAGNOSES[:1]))
    with pytest.raises(InputError, match="case_01: has no maps"):
        blind_validation_page(score(cases), {}, {})
    with pytest.raises(InputError, match="residuals before.npy: cannot be read"):
        residual_maps(tmp_path)


def test_thumbnails_have_one_scale():
    values = np.array([[-60.0, -6.0, 0.0, 6.0, 60.0]])
    (row,) = np.asarray(Image.open(io.BytesIO(thumbnail(values))).convert("RGB")).astype(int)
    assert (row[0] == row[1]).all() and (row[3] == row[4]).all()
    assert row[0][2] > row[0][0] + 50 and row[4][0] > row[4][2] + 50  # blue for negative, red for positive
    assert row[2].min() > 240
    half = np.asarray(Image.open(io.BytesIO(thumbnail(values / 60))).convert("RGB")).astype(int)
    assert half.min() > 150  # one standard deviation is pale, whatever else is in the map


def test_page_shows_its_maps(made):
    picture = made["page"].read_text().split('alt="residuals after" src="data:image/png;base64,')[1].split('"')[0]
    assert base64.b64decode(picture) == thumbnail(np.linspace(-1, 1, 600).reshape(30, 20))


def test_example_is_the_median_of_the_strongest():
    cases = [
        judged(
            truth(f"c{i}", "single", {"heel": {}}, strength),
            diagnosis(f"c{i}", "mismatch explained", {"heel": {}}, removed=removed),
        )
        for i, (strength, removed) in enumerate([("strong", 0.9), ("strong", 0.2), ("strong", 1.0), ("weak", 0.95)])
    ]
    assert example(cases).name == "c0" and example(cases[1:3]).name == "c1" and example(cases[3:]).name == "c3"
    of_mean = truth("c9", "single", {"scatter": {}}, "weak", ["projections"])
    right = judged(of_mean, diagnosis("c9", "mismatch explained", {"scatter": {}}, removed=0.5))
    assert example([*cases, right]).name == "c9"  # the effect in the mean, before a stronger one
    wrong, unexplained = (
        judged(of_mean, diagnosis("c9", verdict, named, removed=0.5))
        for verdict, named in (("mismatch explained", {"heel": {}}), ("mismatch partly explained", {"scatter": {}}))
    )
    assert example([*cases, wrong, unexplained]).name == "c0"
    assert example([wrong]).name == "c9"  # the only one
    assert in_words(cases[0]) == ("heel (strong)", "heel")
    with pytest.raises(InputError, match="no cases"):
        example([])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0.0, "0 %"),
        (0.014, "1.4 %"),
        (0.333, "33 %"),
        (0.996, "99.6 %"),
        (1 - 1e-9, "over 99.9 %"),
        (1.0, "100 %"),
    ],
)
def test_percent(value, text):
    assert percent(value) == text


def test_real_recordings_are_shown_and_not_scored(tmp_path):
    inputs = write_suite(tmp_path)
    cases = collect(inputs["sealed"], inputs["seals"], inputs["verdicts"], inputs["diagnoses"], inputs["others"])
    file = tmp_path / "diagnosis.json"
    document = diagnosis("disc", "mismatch partly explained", {"spectrum": {"kvp": (45.0, 44.0, 46.0)}}, removed=0.9)
    file.write_text(json.dumps(document | {"excess_rms_removed": 0.74, "caveats": ["one repeat"]}))
    with_real, without = score(cases, 80.0, [row(file)]), score(cases, 80.0)
    assert with_real["targets"] == without["targets"] and with_real["counts"] == without["counts"]
    blank = np.zeros((4, 4))
    maps = {case.name: (blank, blank) for case in cases} | {"disc": (blank, blank)}
    text = blind_validation_page(with_real, maps, {"disc": "../diagnosis/disc/report.html"})
    assert 'id="disc"' in text and "74 %" in text and "one repeat" in text and "../diagnosis/disc/report.html" in text
    assert "Real recordings" not in blind_validation_page(without, maps, {})
    with pytest.raises(InputError, match="disc: has no maps"):
        blind_validation_page(with_real, {case.name: (blank, blank) for case in cases}, {})
    with pytest.raises(InputError, match=r"proof.recordings: 'dics' is not under diagnosis.recordings \(disc\)"):
        check_recordings(["dics"], {"disc": {}})
    with pytest.raises(InputError, match="'case_01' is the name of a case"):
        check_recordings(["case_01"], {"case_01": {}})


def test_minutes_are_those_of_the_jobs_on_two_cores(tmp_path):
    for name, seconds in (("a", 60.0), ("b", 180.0)):
        (tmp_path / name).write_text(f"s\th:m:s\tmax_rss\n{seconds}\t0:01:00\t10\n")
    assert minutes([tmp_path / "a", tmp_path / "b"]) == pytest.approx(2.0)
    assert minutes([]) is None
    (tmp_path / "c").write_text("")
    with pytest.raises(InputError, match="c: is not a benchmark"):
        minutes([tmp_path / "c"])
