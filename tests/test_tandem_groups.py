"""Comparison of simulated groups with the tandem study (benchmarks/tandem_groups.py), on tables of known answers."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import common
from benchmarks import tandem_groups as tandem
from benchmarks.common.perturbation import perturb, signed_distance
from virtual_phantom.base.errors import InputError
from virtual_phantom.base.streams import generator, root
from virtual_phantom.features.hu_offset import STORED_OFFSET_HU, convert_to_hu
from virtual_phantom.features.names import FEATURES, MEAN, VARIANCE
from virtual_phantom.features.parameters import DEFAULT, LARGEST, read_parameters
from virtual_phantom.statistics import measured, wilcoxon
from virtual_phantom.statistics.rank_sum import differing_probability

TABLE = Path(__file__).resolve().parents[1] / "../shared/real/ct_phantom4radiomics/features_2d.csv"
NAMES = [f"original_firstorder_{name}" for name in ("Mean", "Variance", "Entropy")]


def table(values, repeats=10, groups=range(1, 9), unit="seed", features=NAMES):
    """Rows of every group, region and repeat, with `values(group, roi, shape)` as features."""
    rows = []
    for group in groups:
        for roi, tissue_class in measured.TISSUE_CLASSES.items():
            found = pd.DataFrame(values(group, roi, (repeats, len(features))), columns=list(features))
            rows.append(found.assign(group=group, roi=roi, tissue_class=tissue_class, **{unit: range(repeats)}))
    return pd.concat(rows, ignore_index=True)


def normal(seed):
    random = generator(seed)
    return lambda group, roi, shape: random.normal(size=shape)


@pytest.mark.parametrize(("repeats", "percent"), [(10, 31.5), (5, 31.0), (4, 34.3)])
def test_chance_level_is_that_of_equal_distributions(repeats, percent):
    assert 100 * differing_probability(repeats, repeats) == pytest.approx(percent, abs=0.05)
    samples = generator(1).normal(size=(2, repeats, 20000))
    assert np.mean(wilcoxon.ranksum_z(*samples) > 1) == pytest.approx(differing_probability(repeats, repeats), abs=0.01)


def test_table_compared_with_itself_has_equal_scores_and_order():
    study = table(normal(2), unit="acquisition", features=FEATURES[:20])
    found = tandem.scores(study, FEATURES[:20])
    assert tandem.scores(study.sample(frac=1, random_state=3), FEATURES[:20]).equals(found)
    assert tandem.spearman(found, found).tolist() == pytest.approx([1.0, 1.0, 1.0])
    assert tandem.means(found).index.tolist() == ["fbp", "iterative", "all"]


def test_regions_of_one_class_are_counted_apart_from_those_of_different_classes():
    """The normal regions differ, and the cysts are one distribution; all classes differ."""
    levels = {"normal_1": 0, "normal_2": 50, "cyst_1": 100, "cyst_2": 100, "hemangioma": 150, "metastasis": 200}
    random = generator(4)
    found = tandem.scores(
        table(lambda group, roi, shape: levels[roi] + random.normal(size=shape), features=FEATURES[:40]), FEATURES[:40]
    )
    overall = tandem.means(found)
    assert (overall["discrimination"] == 100).all()
    assert overall.loc["all", "same_class"] == pytest.approx(50 + 50 * differing_probability(10, 10), abs=4)


def test_sets_of_groups_have_their_own_stability():
    """FBP groups agree, iterative groups are far from each other."""
    random = generator(5)
    apart = dict.fromkeys((2, 4, 6, 8), 0) | {group: 100 * group for group in (1, 3, 5, 7)}
    study = table(lambda group, roi, shape: apart[group] + random.normal(size=shape), features=FEATURES[:40])
    overall = tandem.means(tandem.scores(study, FEATURES[:40]))["stability"]
    expected = 100 * (1 - differing_probability(10, 10))
    assert overall["fbp"] == pytest.approx(expected, abs=4)
    assert overall["iterative"] == 0 and overall["all"] == pytest.approx(expected * 6 / 28, abs=1)


def test_shared_acquisitions_make_equal_groups_stable():
    """With the same values in all groups W is 0 if acquisitions are shared, and has its chance level otherwise."""
    once = {roi: generator(6 + i).normal(size=(18, 3)) for i, roi in enumerate(measured.TISSUE_CLASSES)}
    study = table(lambda group, roi, shape: once[roi], repeats=18, unit="acquisition")
    found = tandem.paired_and_independent(study, "acquisition", draws=20, features=NAMES)
    assert (found["acquisitions"] == 9).all() and (found["paired"] == 100).all()
    assert found["independent"].mean() == pytest.approx(100 * (1 - differing_probability(9, 9)), abs=6)


@pytest.fixture
def sections():
    y, x = np.mgrid[-20:21, -20:21]
    disc = tandem.Section(np.full((17, 41, 41), 40, np.float32), 8, np.hypot(y, x) < 11, (1.0, 0.7, 0.7))
    return {group: {"cyst_1": disc} for group in (1, 2)}


def test_noise_of_controls_has_the_variance_of_its_group(sections):
    sd = pd.Series({1: 10.0, 2: 20.0})
    for realize in (tandem.white_noise(sd), tandem.noise_with_spectrum(sd)):
        found = tandem.control(sections, realize, 20, root(7)).groupby("group")[[MEAN, VARIANCE]].mean()
        assert found[MEAN].to_numpy() - STORED_OFFSET_HU == pytest.approx([40, 40], abs=3)
        assert np.sqrt(found[VARIANCE]).to_numpy() == pytest.approx(sd.to_numpy(), rel=0.1)
    shared = tandem.control(sections, tandem.white_noise(sd), 2, root(7), by_group=False)
    one, other = (shared.loc[shared["group"] == group, MEAN].to_numpy() - STORED_OFFSET_HU - 40 for group in (1, 2))
    assert other == pytest.approx(2 * one, abs=0.1)


def test_perturbation_of_a_uniform_image_changes_only_the_contour(sections):
    found = tandem.control(sections, tandem.perturbation, 10, root(8))
    voxels = sections[1]["cyst_1"].mask.sum()
    assert found["n_voxels"].between(0.75 * voxels, 1.25 * voxels).all()  # all voxels at one distance change together
    assert found["n_voxels"].min() < 0.9 * voxels < 1.1 * voxels < found["n_voxels"].max()
    assert (found[VARIANCE] == 0).all()


def test_perturbed_region_is_inside_or_around_the_region(sections):
    mask = sections[1]["cyst_1"].mask
    distance = signed_distance(mask, (0.7, 0.7))
    assert ((distance < 0) == mask).all()
    image = generator(9).normal(size=(3, *mask.shape))
    new, changed = perturb(image, distance, generator(10))
    assert new.shape == image.shape and ((changed & mask).sum() in (changed.sum(), mask.sum()))


def simulated(parameters, offset_hu):
    rows = table(normal(11), repeats=3, features=FEATURES) if offset_hu == 0 else None
    if rows is None:
        rows = convert_to_hu(table(lambda *key: 1100 + normal(11)(*key), repeats=3, features=FEATURES), offset_hu)
    return rows.assign(
        protocol="group_" + rows["group"].astype(str), noise="mgy10", settings_hash=parameters.hash()
    ).drop(columns="group")


def test_simulated_features_are_converted_to_stored_values(tmp_path):
    study = common.configuration("config/config.yaml")
    made = simulated(read_parameters(None, LARGEST, STORED_OFFSET_HU), STORED_OFFSET_HU)
    made.to_csv(tmp_path / "features.csv", index=False)
    found = tandem.read_simulated(tmp_path / "features.csv", study, "mgy10")
    assert sorted(found["group"].unique()) == list(range(1, 9))
    assert found[MEAN].to_numpy() == pytest.approx(made[MEAN] + STORED_OFFSET_HU)
    with pytest.raises(InputError, match="lacks group 1 at noise level mgy3"):
        tandem.read_simulated(tmp_path / "features.csv", study, "mgy3")


def test_features_of_whole_regions_are_refused(tmp_path):
    simulated(DEFAULT, 0).to_csv(tmp_path / "features.csv", index=False)
    with pytest.raises(InputError, match=r"largest section"):
        tandem.read_simulated(tmp_path / "features.csv", common.configuration("config/config.yaml"), "mgy10")


@pytest.mark.real
@pytest.mark.skipif(not TABLE.exists(), reason="the table of CT-Phantom4Radiomics is not beside the checkout")
def test_pairs_of_measured_acquisitions_do_not_change_the_stability():
    full = measured.load_full_table(TABLE)
    found = tandem.paired_and_independent(full[full["repositioned"] == 0], "acquisition", draws=5)
    assert found["paired"].mean() == pytest.approx(16.2, abs=1)
    assert found["independent"].mean() == pytest.approx(16.2, abs=1)
