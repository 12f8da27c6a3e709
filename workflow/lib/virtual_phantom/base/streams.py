"""All random numbers: which stream is whose.

A stream is a numpy.random.SeedSequence: the same numbers whatever the order of jobs and the number of cores, and apart
from those of every other stream. Nothing else in the project makes one.
"""

from __future__ import annotations

import hashlib
import zlib
from enum import IntEnum

import numpy as np

Stream = np.random.SeedSequence


class Branch(IntEnum):
    """What a branch of a seed is for. A number is never given again to something else: the draws would be the same."""

    PHANTOM = 0
    ACQUISITION = 1
    GAIN_PATTERN = 2  # of seed 0: a detector's pattern is no matter of the study
    AGREEMENT = 3  # images for a diagnosis's table of agreement
    SIMULATED_IMAGES = 4  # images that a diagnosis simulates
    AGREEMENT_ELSEWHERE = 5  # as AGREEMENT, by another protocol
    PROOF_PHANTOM = 6
    REPOSITIONING = 7


def generator(stream: Stream | int) -> np.random.Generator:
    """What draws from a stream, or from that of a seed."""
    return np.random.default_rng(stream)


def root(seed: int) -> Stream:
    """The stream of a seed itself."""
    return Stream(seed)


def branch(seed: int, purpose: int, *keys: int) -> Stream:
    """A branch of a seed, and the branches below it that `keys` name.

    Parameters
    ----------
    seed : int
        The study's seed, or another.
    purpose : int
        One of Branch; of a seed that is not the study's, a number of the caller's own.
    *keys : int
        Branches below, each of the one before.
    """
    return Stream(seed, spawn_key=(int(purpose), *keys))


def below(stream: Stream, *keys: int) -> Stream:
    """A branch of a stream."""
    return Stream(stream.entropy, spawn_key=(*stream.spawn_key, *keys))


def named(stream: Stream, *names: str | int) -> Stream:
    """A branch of a stream for each name, the same however many others are drawn."""
    return below(stream, *(zlib.crc32(str(name).encode()) for name in names))


def acquisition(study_seed: int, geometry: str, noise: str, seed: int) -> Stream:
    """The noise of one acquisition of a study: distinct for every argument."""

    def words(label):
        return np.frombuffer(hashlib.sha256(label.encode()).digest()[:8], dtype=np.uint32).tolist()

    return branch(study_seed, Branch.ACQUISITION, *words(geometry), *words(noise), seed)


def common_acquisition(study_seed: int, seed: int) -> Stream:
    """The noise that all geometries, noise levels and physics have in common in one repeat."""
    return branch(study_seed, Branch.ACQUISITION, seed)
