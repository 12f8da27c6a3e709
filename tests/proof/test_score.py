"""Score of nine cases, calculated by hand."""

import copy
import json

import numpy as np
import pytest
from proof_suite import DIAGNOSES, OTHERS, TRUTHS, diagnosis, judged, metric, truth, write_suite

from virtual_phantom.base.errors import InputError, InputErrors
from virtual_phantom.diagnosis.verdict.verdict import unfitted_diagnosis
from virtual_phantom.diagnosis.verdict_text import SETUP_VERDICTS
from virtual_phantom.physics.effect import names
from virtual_phantom.proof.hiding.case import Case, checked
from virtual_phantom.proof.hiding.catalogue import CATALOGUE
from virtual_phantom.proof.hiding.hidden_effect import EQUATIONS
from virtual_phantom.proof.scoring.collect import collect, collect_verdicts, complete
from virtual_phantom.proof.scoring.headline import headline
from virtual_phantom.proof.scoring.intervals import share, share_of
from virtual_phantom.proof.scoring.remainders import area
from virtual_phantom.proof.scoring.score import score
from virtual_phantom.proof.scoring.verdicts import read_verdicts, verdict_document

NEVER = sorted(set(names()) - set(CATALOGUE))  # tests/proof/test_record.py compares them with the page
COLUMNS = ("before", "after", "floor")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return score(collect(**write_suite(tmp_path_factory.mktemp("suite"))))


def counted(entry):
    return entry["count"], entry["n"]


# Newcombe, Stat. Med. 17, 857 (1998), table I, method 3.
@pytest.mark.parametrize(
    ("count", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_intervals_equal_published_ones(count, n, low, high):
    entry = share([True] * count + [False] * (n - count))
    assert share([0.5] * 2 * count + [0.0] * (n - 2 * count)) == entry
    np.testing.assert_allclose(entry["ci95"], [low, high], atol=5e-5)
    assert counted(entry) == (count, n) and entry["share"] == count / n


def test_counts(found):
    assert found["counts"] == {
        "cases": 9,
        "by_category": {"single": 3, "none": 2, "pair": 2, "unknown": 2},
        "by_kind": {"projections": 8, "images": 1},
        "by_phantom": {"abdomen": 8, "quality_assurance": 1},
        "single_by_strength": {"weak": 1, "medium": 1, "strong": 1},
    }


def test_accuracy(found):
    accuracy = found["accuracy"]
    assert counted(accuracy["first"]["all"]) == (1.5, 3)  # case 2: one of two effects named as equal
    assert counted(accuracy["first"]["medium_or_strong"]) == (1.5, 2)
    assert [counted(accuracy["first"]["by_strength"][name]) for name in ("weak", "medium", "strong")] == [
        (0, 1),
        (0.5, 1),
        (1, 1),
    ]
    assert counted(accuracy["first"]["by_kind"]["images"]) == (0.5, 1)
    assert counted(accuracy["first_or_alternative"]["all"]) == (2, 3)
    assert counted(accuracy["first_or_alternative"]["medium_or_strong"]) == (2, 2)
    assert counted(accuracy["exact"]["all"]) == (3, 7)
    assert [counted(accuracy["exact"][name]) for name in ("single", "none", "pair")] == [(1, 3), (1, 2), (1, 2)]
    assert [counted(accuracy["pairs"][name]) for name in ("both_named", "both_named_or_alternatives", "one_named")] == [
        (1, 2),
        (1, 2),
        (2, 2),
    ]
    assert counted(accuracy["false_alarms"]) == (1, 2)
    assert counted(accuracy["unknown"]) == (1, 2)
    assert counted(accuracy["located"]) == (1, 2)
    assert counted(accuracy["beside"]) == (1, 5) and counted(accuracy["left_open"]) == (0, 2)
    assert accuracy["domains_never_tested"] == ["rows"]


def test_two_alternatives_need_two_named_effects():
    pair = truth("a", "pair", {"bowtie": {}, "heel": {}})
    one = diagnosis("a", "mismatch explained", {"scatter": {}}, {"scatter": ["bowtie", "heel"]})
    two = diagnosis("a", "mismatch explained", {"scatter": {}, "heel": {}}, {"scatter": ["bowtie"]})
    swapped = diagnosis("a", "mismatch explained", {"scatter": {}, "heel": {}}, {"heel": ["bowtie"]})
    assert [judged(pair, said).all_or_alternatives_named for said in (one, two, swapped)] == [False, True, False]


def test_unnamed_difference_is_not_exact_without_a_hidden_effect():
    blank = truth("a", "none")
    assert not judged(blank, diagnosis("a", "unexplained")).exact and judged(blank, diagnosis("a", "match")).exact


def test_reported_setup_error_counts_against_the_diagnosis():
    """Nothing is fitted to it. With nothing hidden it is a false alarm, otherwise a miss."""
    found = {}
    for category, effects in (("single", {"heel": {}}), ("none", {}), ("unknown", {"!periodic_motion": {}})):
        said = unfitted_diagnosis("case_01", SETUP_VERDICTS["description"], [None], shown=None).content
        complete(said, "diagnosis.json")
        hidden_truth = truth("case_01", category, effects, "weak" if category == "single" else None)
        found[category] = score([judged(hidden_truth, said)])
        assert found[category]["cases"][0]["right"] is False
        assert "set-up error" in found[category]["cases"][0]["why_missed"][0]
    assert counted(found["none"]["accuracy"]["false_alarms"]) == (1, 1)
    assert counted(found["single"]["accuracy"]["first"]["all"]) == (0, 1)
    assert counted(found["unknown"]["accuracy"]["unknown"]) == (0, 1)


def test_excess_removed_is_zero_for_unnamed_cases(found):
    removed = found["excess_removed"]["in_library"]  # 0.98, 0.9, none, 1.0, 0.5
    assert removed["n"] == 5 and removed["counted_as_0"] == 1
    assert removed["median"] == pytest.approx(0.9) and removed["median_where_named"] == pytest.approx(0.94)
    assert found["excess_removed"]["lacking"]["median"] == pytest.approx(0.65)


def test_removed_and_remaining_excess_by_correct_and_wrong_names(found):
    removed = found["excess_removed"]
    assert removed["in_library"]["tenth_percentile"] == pytest.approx(
        0.2
    )  # 0, 0.5, 0.9, 0.98, 1: 0.4 of the way to 0.5
    assert removed["images"]["n"] == 1 and removed["images"]["median"] == pytest.approx(0.9)
    assert removed["projections"]["n"] == 4 and removed["projections"]["median"] == pytest.approx(0.74)
    right, wrong = removed["right"], removed["wrong"]
    assert right["n"] == 2 and right["median"] == pytest.approx(0.99)  # cases 1 and 6
    assert wrong["n"] == 4 and wrong["median"] == pytest.approx(0.65)  # cases 2, 5, 8 and 9: 0.9, 0.5, 0.7, 0.6
    assert wrong["tenth_percentile"] == pytest.approx(0.53)
    assert wrong["remainder_sd"] == {"median": 0, "ninetieth_percentile": pytest.approx(1.4), "most": 2}
    assert removed["in_library"]["remainder_sd"]["most"] == 6 and right["remainder_sd"]["most"] == 0


def test_effects_are_counted_from_the_catalog(found):
    effects = found["effects"]
    assert effects["library"] == len(names()) and effects["never_hidden"] == NEVER
    assert effects["can_be_hidden"] == len(names()) - len(NEVER)
    assert effects["models"] == {
        "simulator": {"hidden": ["bowtie", "electronic_noise", "focal_spot", "scatter"], "lacking": []},
        "other": {"hidden": [], "lacking": ["periodic_motion", "rotation_blur"]},
        "own": {"hidden": ["heel"], "lacking": []},
    }
    first = found["accuracy"]["first"]["by_equation"]
    assert [counted(first[source]) for source in EQUATIONS] == [(1.5, 2), (0, 0), (0, 1)]
    assert counted(found["parameters"]["by_equation"]["simulator"]["covered"]) == (1, 2)


def test_parameters(found):
    parameters = found["parameters"]
    first, second = parameters["parameters"]
    assert (first["case"], second["case"]) == ("case_01", "case_06")
    assert first["relative_error"] == pytest.approx(0.04) and first["half_widths"] == pytest.approx(0.5)
    assert second["relative_error"] == pytest.approx(-0.1) and second["half_widths"] == pytest.approx(-2)
    assert (first["covered"], second["covered"]) == (True, False)
    assert parameters["all"]["median_absolute_relative_error"] == pytest.approx(0.07)
    assert parameters["all"]["median_absolute_half_widths"] == pytest.approx(1.25)
    assert parameters["all"]["median_relative_width"] == pytest.approx((0.008 / 0.05 + 0.01 / 0.1) / 2)
    assert counted(parameters["by_effect"]["scatter"]["covered"]) == (1, 2)


def test_errors_are_relative_to_the_hidden_change():
    """A scale of 1 changes nothing: 1.01 instead of 1.03 misses two thirds."""
    hidden_truth = truth("a", "single", {"hu_calibration": {"scale": 1.03, "offset_hu": 0.0}}, "strong", kind="images")
    values = {"scale": (1.01, 1.0, 1.02), "offset_hu": (0.5, -1.0, 2.0)}
    said = diagnosis("a", "mismatch explained", {"hu_calibration": values})
    scale, offset = score([judged(hidden_truth, said)])["parameters"]["parameters"]
    assert scale["relative_error"] == pytest.approx(-2 / 3) and offset["relative_error"] is None


def test_agreement_on_the_held_out_protocol(found):
    agreement = found["agreement"]
    contrast, features = agreement["metrics"]["contrast"], agreement["metrics"]["features"]
    assert contrast["n"] == 2 and contrast["dukesim"] == 0.014
    assert [contrast[key] for key in ("before", "after", "floor")] == pytest.approx([0.04, 0.015, 0.005])
    assert agreement["by_phantom"]["abdomen"]["contrast"] == {key: contrast[key] for key in ("n", *COLUMNS)}
    assert [features[key] for key in ("before", "after", "floor")] == [0.4, 0.9, 0.7]
    assert agreement["metrics"]["noise_texture"]["n"] == 0 and agreement["metrics"]["noise_texture"]["after"] is None
    assert agreement["missing"] == ["case_03"] and agreement["cases"] == 3


def test_confusion(found):
    matrix = found["confusion"]
    assert matrix["rows"] == [
        "focal_spot",
        "heel",
        "scatter",
        "nothing",
        "periodic_motion (not in library)",
        "rotation_blur (not in library)",
    ]
    cells = {(cell["row"], cell["column"]): cell for cell in matrix["cells"]}
    expected = {
        ("scatter", "scatter"): ("strong", "right"),
        ("focal_spot", "xray_crosstalk"): ("medium", "alternative"),
        ("heel", "nothing"): ("weak", "wrong"),
        ("nothing", "nothing"): (None, "right"),
        ("nothing", "gain_pattern"): (None, "wrong"),
        ("periodic_motion (not in library)", "veiling_glare"): (None, "right"),
        ("rotation_blur (not in library)", "focal_spot"): (None, "wrong"),
    }
    assert {key: (cell["strength"], *[k for k, n in cell["outcomes"].items() if n]) for key, cell in cells.items()} == (
        expected
    )
    assert np.sum(matrix["counts"]) == 7 and matrix["pairs_left_out"] == 2
    assert matrix["counts"][matrix["rows"].index("heel")][matrix["columns"].index("nothing")] == 1


def test_equivalent_effect_declared_in_advance_counts_as_reported():
    hidden_truth = truth("a", "unknown", {"!charge_sharing": {}})
    hidden_truth["effects"][0]["equals"] = [["optical_crosstalk"], ["optical_crosstalk", "photon_flux"]]
    said = {
        "an equal": diagnosis("a", "mismatch explained", {"optical_crosstalk": {}}),
        "and another": diagnosis("a", "mismatch explained", {"optical_crosstalk": {}, "heel": {}}),
        "half of one": diagnosis("a", "mismatch explained", {"photon_flux": {}}),
        "left": diagnosis("a", "mismatch partly explained", {"heel": {}}),
        "nothing": diagnosis("a", "match"),
    }
    owned = {name: judged(hidden_truth, one).reported_unexplained for name, one in said.items()}
    assert owned == {"an equal": True, "and another": False, "half of one": False, "left": True, "nothing": False}
    assert judged(hidden_truth, said["an equal"]).right


def test_another_object_reports_faults_of_the_object_alone():
    said = unfitted_diagnosis("a", SETUP_VERDICTS["object"], [None], shown=None).content
    faults = {name: truth("a", "unknown", {f"!{name}": {}}) for name in ("patient_table", "lost_views")}
    owned = {name: judged(hidden_truth, said).right for name, hidden_truth in faults.items()}
    assert owned == {"patient_table": True, "lost_views": False}


def test_remainders_measure_the_missing_models(found):
    """Cases 8 and 9 have 0 and 2 standard deviations left; cases with the correct names or none have 0."""
    remainders = found["remainders"]
    assert {name: counted(one) for name, one in remainders["by_kind"].items()} == {
        "periodic_motion": (1, 1),
        "rotation_blur": (0, 1),
    }
    assert (remainders["lacking"], remainders["had"]) == (2, 3)
    assert remainders["area"] == pytest.approx((3 + 3 * 0.5) / 6)
    assert remainders["curve"] == [
        {"bound": 2.0, "lacking": 0.5, "had": 0.0},
        {"bound": 0.0, "lacking": 1.0, "had": 1.0},
    ]
    assert area([3.0, 1.0], [2.0]) == 0.5 and area([], [1.0]) is None


def test_calibration(found):
    none, one, more = found["calibration"]["first_named"]
    assert counted(none["came_true"]) == (2, 3) and counted(none["with_lacking"]) == (2, 5)
    assert none["stated_at_least"] == pytest.approx(20.0855 / 21.0855, abs=1e-4)
    assert counted(one["came_true"]) == (1, 2) and counted(one["or_alternative"]) == (2, 2) and one["kept"]
    assert one["stated_at_least"] == 0.5
    assert counted(more["came_true"]) == (0, 0) and more["kept"] is None
    low, high = found["calibration"]["gain"]
    assert (low["stated"], high["stated"]) == ("gain under 10", "gain 100 to 1000")
    assert counted(low["came_true"]) == (0, 2) and low["kept"] is False
    assert counted(high["came_true"]) == (4, 4) and high["kept"] is True
    assert low["stated_at_least"] == pytest.approx(1 / (1 + np.exp(-6)))
    (chance,) = found["calibration"]["p"]
    assert counted(chance["came_true"]) == (4, 6) and counted(chance["with_lacking"]) == (4, 8)
    (out,) = found["calibration"]["ruled_out"]
    assert counted(out["came_true"]) == (0, 0) and counted(out["with_lacking"]) == (1, 1)
    verdicts = {line["stated"]: counted(line["with_lacking"]) for line in found["calibration"]["verdict"]}
    assert verdicts == {
        "match": (1, 2),
        "match for practical purposes": (0, 0),
        "mismatch explained": (2, 5),
        "mismatch partly explained": (2, 2),
        "unexplained": (0, 0),
    }


def test_targets(found):
    reached = {target["name"]: target["reached"] for target in found["targets"]}
    assert reached == {
        "first_medium_or_strong": False,
        "first_weak": None,  # the only one is hidden by the library's own equation
        "exact": False,
        "pairs": True,  # as is one of the pairs
        "false_alarms": False,
        "false_alarms_undeclared": None,
        "unknown": False,
        "intervals": False,
        "excess_removed": True,
        "contrast": False,
        "noise_magnitude": None,
        "noise_texture": None,
        "resolution": True,
        "minutes": None,
    }


def test_targets_without_cases_are_open(tmp_path):
    found = score(collect(**write_suite(tmp_path, TRUTHS[3:4], DIAGNOSES[3:4])), minutes=181.0)
    reached = {target["name"]: target["reached"] for target in found["targets"]}
    assert reached.pop("false_alarms") is True and reached.pop("minutes") is False
    assert set(reached.values()) == {None}
    json.dumps(found, allow_nan=False)


def test_reasons_of_missed_cases(found):
    reasons = {row["case"]: " ".join(row["why_missed"]) for row in found["cases"]}
    assert [case for case, reason in reasons.items() if not reason] == ["case_01", "case_04", "case_06", "case_08"]
    assert reasons["case_02"].startswith("Focal spot was reported as an alternative to X-ray crosstalk")
    assert reasons["case_03"].startswith("Too little signal")
    assert "columns (column 3 of 64)" in reasons["case_05"]
    assert reasons["case_07"].startswith("Bowtie was reported as an alternative to heel")
    assert "focal spot explains the whole difference" in reasons["case_09"]


def test_truth_that_was_ruled_out_is_reported_with_its_loss():
    said = diagnosis("a", "mismatch explained", {"heel": {}}, ruled_out={"bowtie": 123.4})
    (row,) = score([judged(truth("a", "single", {"bowtie": {}}, "strong"), said)])["cases"]
    assert (
        "Bowtie was ruled out: as a replacement, it would lower the log score by at least 123." in row["why_missed"][0]
    )


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t["effects"][0].update(name="scattering"), "the library lacks scattering"),
        (lambda t: t["effects"][0].update(known=False), "the library has scatter"),
        (lambda t: t.update(category="pair"), "category pair does not fit"),
        (lambda t: t.update(category="unknown"), "the library has every hidden effect"),
        (lambda t: t.update(strength="huge"), "strength"),
        (lambda t: t.update(strength=None), "no strength"),
        (lambda t: t.pop("where"), "where"),
    ],
)
def test_inconsistent_truths_are_rejected(change, said):
    content = copy.deepcopy(TRUTHS[0])
    change(content)
    with pytest.raises(InputError, match=f"case.json: is not the truth of a case .*{said}"):
        checked(content, "case.json")


def test_broken_diagnosis_is_named(tmp_path):
    suite_files = write_suite(tmp_path, TRUTHS[:1], [DIAGNOSES[0] | {"verdict": "guilty"}])
    with pytest.raises(InputError, match="case_01/diagnosis.json: .*'guilty'"):
        collect(**suite_files)


def test_broken_table_is_named(tmp_path):
    broken = {"metrics": {"contrast": {"before": metric(0, 0, 0)["before"]}}}
    for folder, table, line in (
        ("entry", broken, "contrast has no before, after and floor"),
        ("table", broken["metrics"], "has no metrics"),
    ):
        with pytest.raises(InputError, match=f"held_out_protocol.json: {line}"):
            collect(**write_suite(tmp_path / folder, others=OTHERS | {"case_01": table}))


def test_group_of_equals_scores_its_share_and_is_never_exact():
    single = truth("a", "single", {"scatter": {}}, "strong")
    pair = truth("b", "pair", {"scatter": {}, "bowtie": {}})
    said = {
        "alone": {"effects": [["scatter"]]},
        "first of three": {"effects": [["scatter", "bowtie", "dark_signal"]]},
        "last of two": {"effects": [["bowtie", "scatter"]]},
        "second": {"effects": [["bowtie"], ["scatter"]]},
        "both": {"effects": [["scatter", "spectrum"], ["bowtie", "dark_signal"]]},
        "one group": {"effects": [["scatter", "bowtie"]]},
    }

    def case(sealed, name):
        return Case(sealed, {"case": "a", "unexplained": False} | said[name])

    assert [case(single, name).first_credit for name in said] == pytest.approx([1, 1 / 3, 1 / 2, 0, 1 / 2, 1 / 2])
    assert [case(pair, name).all_credit for name in said] == pytest.approx([0, 0, 0, 1, 1 / 4, 0])
    assert [name for name in said if case(single, name).exact] == ["alone"]
    assert [name for name in said if case(pair, name).exact] == ["second"]


def test_headline_by_class_and_equation():
    """Six singles by each simulator; own equations are counted apart; false alarms by undeclared deviations."""
    fields = {"geometry": "helix", "object": "disc"}
    undeclared = {"object": {}, "shape_mm": 0.1, "pose": {}, "declared": {}, "undeclared": {"scatter": 0.001}}

    def case(number, simulator, named, category="single", effects=("scatter",), **more):
        strength = "strong" if effects else None
        sealed = truth(f"c{number}", category, dict.fromkeys(effects, {}), strength, **fields, **more)
        sealed["simulator"] = simulator
        return Case(sealed, {"case": f"c{number}", "effects": named, "unexplained": False})

    cases = [case(n, "xcist", [["scatter"]], equation="simulator") for n in range(6)]
    cases += [case(6 + n, "gvirtualxray", [["scatter"]] if n < 4 else [], equation="other") for n in range(6)]
    cases += [case(12, "xcist", [], equation="own")]
    cases += [case(13, "xcist", [["heel"]], "none", (), imperfections=undeclared), case(14, "xcist", [], "none", ())]
    found = headline(cases)
    assert counted(found["all"]["first_medium_or_strong"]) == (10, 12)
    assert counted(found["own"]["first_medium_or_strong"]) == (0, 1)
    assert found["by_significance"] == found["all"]
    assert counted(found["all"]["false_alarms"]) == (0, 1) and counted(found["all"]["false_alarms_undeclared"]) == (
        1,
        1,
    )
    assert counted(found["classes"]["simulator"]["gvirtualxray"]["first_medium_or_strong"]) == (4, 6)
    worst = found["worst"]["first_medium_or_strong"]
    assert (worst["kind"], worst["class"], worst["count"]) == ("simulator", "gvirtualxray", 4)
    assert "false_alarms" not in found["worst"]  # too few scores
    assert share_of(10, 12)["ci95"] == found["all"]["first_medium_or_strong"]["ci95"]


def test_verdicts_of_any_program_have_the_score_of_the_diagnosis(tmp_path, found):
    files = write_suite(tmp_path)
    documents = {verdict["case"]: verdict for verdict in map(verdict_document, DIAGNOSES)}
    assert headline(collect_verdicts(files["sealed"], files["seals"], documents)) == found["headline"]


def test_every_bad_verdict_file_has_a_line(tmp_path):
    good = verdict_document(DIAGNOSES[0])
    contents = {
        "case_01": good,
        "case_02": good | {"case": "case_02", "effects": [["scater"]]},
        "case_03": good,
        "case_04": {"case": "case_04", "effects": ["scatter"], "unexplained": False},
        "case_99": good | {"case": "case_99"},
    }
    for name, content in contents.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    (tmp_path / "case_05.json").write_text("{")
    with pytest.raises(InputErrors) as raised:
        read_verdicts(tmp_path.glob("*.json"), [f"case_0{number}" for number in range(1, 7)])
    lines = [line.removeprefix(f"{tmp_path}/") for line in raised.value.lines]
    assert len(lines) == 6
    expected = ("scater", "use the name of the file", "effects", "is no verdict.json", "is missing", "no case_99")
    for line, number, part in zip(lines, (2, 3, 4, 5, 6, 99), expected, strict=True):
        assert line.startswith(f"case_{number:02}.json: ") and part in line, line


def test_named_effects_without_relevance_are_a_match():
    said = diagnosis("a", "match for practical purposes", {"scatter": {}})
    assert judged(truth("a", "none"), said).match and judged(truth("a", "none"), said).right
    assert judged(truth("a", "single", {"scatter": {}}, "weak"), said).first_credit == 1
    strong, nothing = judged(truth("a", "single", {"scatter": {}}, "strong"), said), judged(truth("a", "none"), said)
    assert strong.first_credit == 0 and strong.by_significance.first_credit == 1
    assert not nothing.by_significance.match
