"""The noise of no two acquisitions is related, and that of each is its own whatever else is drawn."""

import itertools

import numpy as np

from virtual_phantom.physics.noise import acquire, acquisition_seed

LINES = np.full((10, 20, 50), 1.0)
LABELS = list(itertools.product(("views150", "views300"), ("dose10", "double"), range(10)))


def counts(geometry, noise, seed):
    labels = dict(geometry=geometry, noise=noise, seed=seed)
    return acquire(LINES, **labels, noise_level=1e-4, model="physical", study_seed=2022).data


def test_streams_are_uncorrelated():
    drawn = np.array([counts(*one).ravel() for one in LABELS], float)
    correlation = np.corrcoef(drawn)[np.triu_indices(len(LABELS), 1)]
    # Of n values each: standard deviation 1 / sqrt(n); the largest of 780 lies under 4.5 of them with 99.5 %.
    z = correlation * np.sqrt(LINES.size)
    assert np.abs(z).max() < 4.5
    assert 0.9 < z.std() < 1.1 and abs(z.mean()) < 0.2


def test_shifted_streams_are_uncorrelated():
    """Two seeds that shared a stream with an offset would show here and not above."""
    first, second = (counts("views150", "dose10", seed).ravel().astype(float) for seed in (0, 1))
    n = LINES.size
    product = np.fft.irfft(np.fft.rfft(first - first.mean()) * np.conj(np.fft.rfft(second - second.mean())), n)
    assert np.abs(product).max() / (first.std() * second.std() * n) < 5.5 / np.sqrt(n)


def test_no_two_of_many_acquisitions_have_one_stream():
    labels = itertools.product((f"views{n}" for n in range(100, 120)), ("a", "b", "ab"), range(100))
    states = {tuple(acquisition_seed(1, *one).generate_state(4)) for one in labels}
    assert len(states) == 20 * 3 * 100
