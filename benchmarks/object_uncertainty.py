"""Diagnose scans with a slightly wrong object, told as exact and with its default uncertainty (15 minutes of CPU)."""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common import simulator_scans
from virtual_phantom.base.streams import Branch, branch
from virtual_phantom.config.dependencies import resource
from virtual_phantom.diagnosis.candidate_effects import candidates
from virtual_phantom.diagnosis.run import run_diagnosis
from virtual_phantom.io.volumes import Volume, read_nifti, write_nifti

FIELDS = "seed phantom hidden strength told exact verdict named first right alternatives object cpu_s".split()


def above(hu, threshold, changed):
    return np.where(hu > threshold, changed, hu)


TOLD = {
    "as scanned": lambda hu: hu,
    "+5 HU above 60 HU": lambda hu: above(hu, 60, hu + 5),
    "x 1.01": lambda hu: (hu + 1000) * 1.01 - 1000,
    "+3 % above 150 HU": lambda hu: above(hu, 150, (hu + 1000) * 1.03 - 1000),
    "+2 HU": lambda hu: above(hu, -950, hu + 2),
    "x 1.005": lambda hu: (hu + 1000) * 1.005 - 1000,
}
