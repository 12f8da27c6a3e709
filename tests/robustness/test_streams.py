"""Noise of acquisitions is independent unless a study requests common random numbers, and does not depend on other
draws.
"""

import ast
import itertools

import numpy as np
import pytest

from virtual_phantom.base import streams
from virtual_phantom.base.geometry import circular
from virtual_phantom.config.dependencies import LIBRARY
from virtual_phantom.physics.state import State
from virtual_phantom.simulation.acquire import acquire

LINES = np.full((10, 20, 50), 1.0)
LABELS = list(itertools.product(("views150", "views300"), ("dose10", "double"), range(10)))


def counts(geometry, noise, seed, lines=LINES, level=1e-4, **options):
    labels = dict(geometry=geometry, noise=noise, seed=seed)
    return acquire(lines, **labels, noise_level=level, model="physical", study_seed=2022, **options).data


def test_streams_are_uncorrelated():
    drawn = np.array([counts(*label).ravel() for label in LABELS], float)
    correlation = np.corrcoef(drawn)[np.triu_indices(len(LABELS), 1)]
    # For n values each, the standard deviation is 1 / sqrt(n); the largest of 780 is below 4.5 of them with 99.5 %.
    z = correlation * np.sqrt(LINES.size)
    assert np.abs(z).max() < 4.5
    assert 0.9 < z.std() < 1.1 and abs(z.mean()) < 0.2


def test_shifted_streams_are_uncorrelated():
    """Two seeds that shared a stream with an offset would correlate here and not above."""
    first, second = (counts("views150", "dose10", seed).ravel().astype(float) for seed in (0, 1))
    n = LINES.size
    product = np.fft.irfft(np.fft.rfft(first - first.mean()) * np.conj(np.fft.rfft(second - second.mean())), n)
    assert np.abs(product).max() / (first.std() * second.std() * n) < 5.5 / np.sqrt(n)


def test_no_two_of_many_acquisitions_share_a_stream():
    labels = itertools.product((f"views{n}" for n in range(100, 120)), ("a", "b", "ab"), range(100))
    states = {tuple(streams.acquisition(1, *label).generate_state(4)) for label in labels}
    assert len(states) == 20 * 3 * 100


def test_common_random_numbers_are_equal_quantiles():
    """Levels and physics of one repeat: standardized counts agree up to their steps and are those of the repeat."""
    base = counts("views150", "dose10", 0, draws="common").astype(float)
    np.testing.assert_array_equal(base, counts("views300", "double", 0, draws="common"))
    brighter = counts("views150", "half", 0, LINES - 0.1, 0.5e-4, draws="common").astype(float)
    means = 1e4 * np.exp(-1), 2e4 * np.exp(-0.9)
    deviates = [(one - mean) / np.sqrt(mean) for one, mean in zip((base, brighter), means, strict=True)]
    # The skewness of counts, 1/sqrt(mean), moves their quantiles by (w^2 - 1) / (6 sqrt(mean)).
    bound = np.sqrt(1 / 12 / means[0] + 1 / 12 / means[1] + (means[0] ** -0.5 - means[1] ** -0.5) ** 2 / 18)
    assert np.std(deviates[0] - deviates[1]) == pytest.approx(bound, rel=0.05)
    other = counts("views150", "dose10", 1, draws="common").astype(float)
    assert abs(np.corrcoef(base.ravel(), other.ravel())[0, 1]) < 4.5 / np.sqrt(LINES.size)
    alone = counts("views150", "dose10", 0).astype(float)
    assert abs(np.corrcoef(base.ravel(), alone.ravel())[0, 1]) < 4.5 / np.sqrt(LINES.size)


def test_photon_counts_do_not_depend_on_other_random_numbers():
    """With electronic noise or afterglow, and in a chain without effects as in the study without a chain."""
    geometry = circular(
        views=10,
        source_to_isocentre_mm=500.0,
        source_to_detector_mm=1000.0,
        columns=50,
        rows=20,
        column_pitch_mm=2.0,
        row_pitch_mm=2.0,
    )
    plain = State(geometry, photons=1.0, signal=np.exp(-LINES), air=np.ones((1, 20, 50)))
    photons = counts("a", "b", 0, draws="common")
    np.testing.assert_array_equal(counts("a", "b", 0, draws="common", state=plain), photons)
    noisy, glowing = (
        counts("a", "b", 0, draws="common", state=State(geometry, 1.0, signal=plain.signal, air=plain.air, **extra))
        for extra in ({"electronic": 5.0}, {"lag": (0.1, 0.5, 1.0)})
    )
    assert np.std(noisy - photons) == pytest.approx(5, rel=0.03)
    mean = 1e4 * np.exp(-1)
    both = np.corrcoef((glowing - mean).ravel(), (photons - mean).ravel())[0, 1]
    # A view's own photons contribute 0.9 + 0.1 times the share in the same view: 0.9 over the root of the sum of
    # squares.
    assert both == pytest.approx(0.9 / np.sqrt(0.9**2 + 0.1**2 * 0.5 / 1.5), abs=0.01)


def test_unknown_mode_of_random_numbers_is_rejected():
    with pytest.raises(ValueError, match="draws 'shared': use independent or common"):
        counts("a", "b", 0, draws="shared")
    assert (
        streams.common_acquisition(1, 0).generate_state(4).tolist()
        != streams.common_acquisition(1, 1).generate_state(4).tolist()
    )


def test_one_module_creates_all_streams():
    """In the library and its scripts; XCIST's global state is seeded from a stream."""
    makers = {"SeedSequence", "default_rng", "RandomState", "PCG64", "seed"}
    found = set()
    for path in [*LIBRARY.rglob("*.py"), *(LIBRARY.parents[1] / "scripts").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and node.attr in makers and ast.unparse(node.value).endswith("random"):
                found.add(path.name)
    assert found == {"streams.py", "xcist.py"}


def test_branches_differ():
    assert len(set(streams.Branch)) == len(streams.Branch.__members__)
