"""Random streams: all random numbers of the project come from here.

A stream is a numpy.random.SeedSequence. Its numbers depend neither on the order of jobs nor on the number of cores, and
are independent of those of other streams.
"""

from __future__ import annotations

import hashlib
import zlib
from enum import IntEnum

import numpy as np

Stream = np.random.SeedSequence


class Branch(IntEnum):
    """Purpose of a branch of a seed. A number is never reused for another purpose: random numbers would repeat."""

    PHANTOM = 0
    ACQUISITION = 1
    GAIN_PATTERN = 2  # of seed 0, because a detector's pattern does not depend on the study
    AGREEMENT = 3  # images for the agreement table of a diagnosis
    SIMULATED_IMAGES = 4  # images that a diagnosis simulates
    AGREEMENT_OTHER_PROTOCOL = 5  # images for the agreement table of a scan by another protocol
    PROOF_PHANTOM = 6
    REPOSITIONING = 7
    START_ANGLE = 8
    NOISE_CONTROL = 9  # white noise on the phantom, without a scan
    RINGS = 10  # of seed 0, as GAIN_PATTERN


def generator(stream: Stream | int) -> np.random.Generator:
    """Return a generator for a stream or a seed."""
    return np.random.default_rng(stream)


def root(seed: int) -> Stream:
    """Return the stream of a seed."""
    return Stream(seed)


def branch(seed: int, purpose: int, *keys: int) -> Stream:
    """Return a branch of a seed, and below it the branches given by `keys`.

    `purpose` is a Branch. With a seed that is not the study's, callers may choose other numbers.
    """
    return Stream(seed, spawn_key=(int(purpose), *keys))


def below(stream: Stream, *keys: int) -> Stream:
    """Return a branch of a stream."""
    return Stream(stream.entropy, spawn_key=(*stream.spawn_key, *keys))


def named(stream: Stream, *names: str | int) -> Stream:
    """Return a branch of a stream for names, independent of which other names are used."""
    return below(stream, *(zlib.crc32(str(name).encode()) for name in names))


def acquisition(study_seed: int, geometry: str, noise: str, seed: int) -> Stream:
    """Return the noise stream of one acquisition of a study; every argument changes the stream."""

    def words(label):
        return np.frombuffer(hashlib.sha256(label.encode()).digest()[:8], dtype=np.uint32).tolist()

    return branch(study_seed, Branch.ACQUISITION, *words(geometry), *words(noise), seed)


def common_acquisition(study_seed: int, seed: int) -> Stream:
    """Return the noise stream of one repeat that all geometries, noise levels and physics share."""
    return branch(study_seed, Branch.ACQUISITION, seed)


def random_start_angle_deg(study_seed: int, seed: int) -> float:
    """Return the angle of the first view of a repeat, degrees, the same for all of its scans."""
    return float(generator(branch(study_seed, Branch.START_ANGLE, seed)).uniform(0, 360))
