"""Seals and verdicts: later changes are detected."""

import hashlib
import json

import pytest
from proof_suite import SALT, TRUTHS, write_suite

from virtual_phantom.base.errors import InputError
from virtual_phantom.proof.hiding import seal
from virtual_phantom.proof.scoring.collect import collect


def changed(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def exchange(first, second):
    """Swap the contents of two files."""
    texts = first.read_text(), second.read_text()
    first.write_text(texts[1])
    second.write_text(texts[0])


def test_digest_is_sha256_of_salt_and_canonical_json():
    text = SALT + '{"case":"a","x":[1,0.1,null,"\\u00e9"]}'
    document = seal.sealed({"x": (1, 0.1, None, "é"), "case": "a"}, SALT)
    assert seal.digest(document) == hashlib.sha256(text.encode()).hexdigest()
    assert seal.publish([document]) == {"a": seal.digest(document)}


def test_seal_opens_to_the_truth(tmp_path):
    document = seal.sealed(TRUTHS[0], SALT)
    seal.write(document, tmp_path / "case_01.json")
    assert seal.open_seal(tmp_path / "case_01.json", seal.publish([document])) == TRUTHS[0]


@pytest.mark.parametrize("salt", ["", "5A" * 32, "5a" * 31, 7 * "5a" + "\n"])
def test_other_salts_are_rejected(salt):
    with pytest.raises(ValueError, match="64 hexadecimal digits"):
        seal.sealed(TRUTHS[0], salt)


def test_case_is_sealed_once():
    document = seal.sealed(TRUTHS[0], SALT)
    with pytest.raises(ValueError, match="twice"):
        seal.publish([document, document])


CHANGED = "the truth or the salt of case_01 was changed"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["truth"]["effects"][0]["comparable"].update(amount=0.0500001), CHANGED),
        (lambda c: c["truth"].update(category="pair"), CHANGED),
        (lambda c: c["truth"]["where"].reverse(), CHANGED),
        (lambda c: c.update(salt="5b" + SALT[2:]), CHANGED),
        (lambda c: c["truth"].update(case="case_02"), CHANGED),
        (lambda c: c.update(case="case_02"), "contains case case_02"),
    ],
)
def test_changed_truth_or_salt_is_detected(tmp_path, change, message):
    suite_files = write_suite(tmp_path)
    changed(suite_files["sealed"][0], change)
    with pytest.raises(InputError, match=f"case_01.json: {message}"):
        collect(**suite_files)


def test_exchanged_truths_are_detected(tmp_path):
    """Both are published, but a scan that reads one by its name would hide the other."""
    suite_files = write_suite(tmp_path)
    exchange(*suite_files["sealed"][:2])
    with pytest.raises(InputError, match="case_01.json: contains case case_02"):
        collect(**suite_files)


def test_unpublished_case_is_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    changed(suite_files["seals"], lambda seals: seals.pop("case_03"))
    del suite_files["verdicts"][2]
    with pytest.raises(InputError, match="case_03 is not among the published seals"):
        collect(**suite_files)


@pytest.mark.parametrize("content", ["{}", "[]", "nonsense", '{"case": "case_01", "truth": 3, "salt": 4}'])
def test_broken_seal_is_named(tmp_path, content):
    path = tmp_path / "broken.json"
    path.write_text(content)
    with pytest.raises(InputError, match="broken.json"):
        seal.open_seal(path, {"case_01": "0"})


def test_diagnosis_changed_after_its_verdict_is_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    path = suite_files["diagnoses"][2]
    path.write_text(path.read_text().replace("match", "unexplained"))
    with pytest.raises(InputError, match="case_03/diagnosis.json: was changed after its verdict"):
        collect(**suite_files)


def test_additional_space_in_a_diagnosis_is_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    path = suite_files["diagnoses"][0]
    path.write_text(path.read_text() + " ")
    with pytest.raises(InputError, match="was changed after"):
        collect(**suite_files)


def test_changed_verdict_is_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    path = suite_files["verdicts"][1]
    seal.write(seal.read(path) | {"files": seal.read(path)["files"] | {"diagnosis_sha256": "0" * 64}}, path)
    with pytest.raises(InputError, match="case_02/diagnosis.json: was changed after its verdict"):
        collect(**suite_files)


def test_verdict_other_than_its_diagnosis_is_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    path = suite_files["verdicts"][1]
    seal.write(seal.read(path) | {"effects": [["focal_spot"]]}, path)
    with pytest.raises(InputError, match="case_02.json: the verdict differs from .*case_02/diagnosis.json"):
        collect(**suite_files)


def test_exchanged_diagnoses_are_detected(tmp_path):
    suite_files = write_suite(tmp_path)
    exchange(*suite_files["diagnoses"][:2])
    with pytest.raises(InputError, match="was changed after its verdict"):
        collect(**suite_files)


def test_diagnosis_of_another_case_is_detected_although_it_was_bound(tmp_path):
    suite_files = write_suite(tmp_path)
    seal.write(seal.read(suite_files["diagnoses"][2]), suite_files["diagnoses"][3])
    path = suite_files["verdicts"][3]
    seal.write(seal.read(path) | {"files": seal.files_of(suite_files["diagnoses"][3])}, path)
    with pytest.raises(InputError, match="case_04/diagnosis.json: is the diagnosis of 'case_03'"):
        collect(**suite_files)


def test_table_of_another_protocol_is_bound_too(tmp_path):
    suite_files = write_suite(tmp_path)
    changed(
        suite_files["others"][0], lambda table: table["metrics"]["contrast"]["after"].update(relative_difference=0.0)
    )
    with pytest.raises(InputError, match="case_01/held_out_protocol.json: was changed after its verdict"):
        collect(**suite_files)
    del suite_files["others"][0]
    with pytest.raises(InputError, match="case_01.json: the verdict does not match the present files of case_01"):
        collect(**suite_files)


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("sealed", "seals.json: case_05 was published but has no sealed truth"),
        ("diagnoses", "seals.json: case_05 was published but has no diagnosis"),
        ("verdicts", "case_05.json: is missing"),
    ],
)
def test_every_published_case_counts(tmp_path, key, message):
    suite_files = write_suite(tmp_path)
    del suite_files[key][4]
    with pytest.raises(InputError, match=message):
        collect(**suite_files)
