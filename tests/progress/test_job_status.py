"""Status messages of a job and their display, with a small diagnosis and a clock that the test sets."""

import io
import json
import logging
import os

import numpy as np
import pytest
from simulated_scans import body, noisy_lines
from snakemake_interface_logger_plugins.common import LogEvent

from virtual_phantom.base.geometry import Grid, circular
from virtual_phantom.diagnosis.projections import observed, prepared
from virtual_phantom.diagnosis.run import find_missing_physics
from virtual_phantom.diagnosis.selection.fit_cache import FitCache
from virtual_phantom.diagnosis.selection.progress import (
    ALIGNED,
    COMPARED,
    FITTED,
    JUDGED,
    LEFT_AFTER,
    RANKED,
    DiagnosisProgress,
)
from virtual_phantom.physics.beam.materials import Segmentation
from virtual_phantom.physics.chain import Chain
from virtual_phantom.physics.scenes.scene import VoxelScene
from virtual_phantom.study.job import job
from virtual_phantom.study.progress.console import Console
from virtual_phantom.study.progress.job_status import (
    JobStatus,
    read_status,
    remove_status,
    status_path,
    status_writer,
    write_status,
)
from virtual_phantom.study.progress.time_left import Progress, Step

GEOMETRY = circular(
    views=24,
    source_to_isocentre_mm=570.0,
    source_to_detector_mm=1040.0,
    columns=32,
    rows=2,
    column_pitch_mm=14.0,
    row_pitch_mm=12.0,
)
CANDIDATES = ("scatter", "detector_offset", "heel")


def ready():
    """Prepared recording with scatter."""
    grid = Grid((6, 40, 40), (5.0, 6.0, 6.0))
    scene = VoxelScene.of(body(grid, (90, 70), 20.0, [((35, 10, 0), 18, 800.0)]), Segmentation(), 0.0193)
    chain = Chain(scene, GEOMETRY, photons=1e5)
    state = chain.state({"scatter": {"amount": 0.05, "width_mm": 60.0}})
    lines = noisy_lines(state, 4, np.random.default_rng(7)).astype(np.float32)
    taken = observed.Scans(lines, state.measured_air.mean(axis=0) * state.photons, np.ones(lines[0].shape, bool))
    return prepared.prepare(taken, None, chain, nominal_photons=1e5)


class Watched:
    """A run of one diagnosis, whose clock advances a minute with each status message."""

    def __init__(self, folder, expected=600.0):
        self.log, self.stream = folder / "diagnose.log", io.StringIO()
        step = Step(0, "diagnose", ("diagnosis.json",), threads=2, log=str(self.log))
        self.now = 0.0  # files are newer than the job
        progress = Progress([step], 2, lambda: {"diagnosis.json": expected}, self.now)
        self.console = Console(logging.StreamHandler(self.stream), progress, "logs", clock=lambda: self.now)
        self.take(LogEvent.JOB_INFO, jobid=0)

    def take(self, event, **more):
        self.console.emit(logging.makeLogRecord({"event": event, **more}))

    def look(self):
        self.now += 60.0
        self.take("time_passed")

    def lines(self):
        return [line[9:] for line in self.stream.getvalue().splitlines()]


@pytest.mark.parametrize("processes", [1, 2])
def test_small_diagnosis_reports_until_its_verdict(processes, tmp_path):
    run, tell = Watched(tmp_path), status_writer(tmp_path / "diagnose.log", "bench")

    def status_lines(progress):
        tell(progress)
        run.look()

    found = find_missing_physics(
        "bench", ready(), CANDIDATES, {"default": 0.02}, processes, progress=DiagnosisProgress(status_lines)
    )
    assert [effect["name"] for effect in found.content["effects"]] == ["scatter"]
    texts = [line.partition("bench: ")[2] for line in run.lines() if "bench: " in line]
    assert texts[0] == "alignment fitted"
    assert texts[1:5] == [f"alignment fitted; {done}3 effects ranked" for done in ("0 of ", "1 of ", "2 of ", "")]
    assert texts[5].startswith("alignment fitted; 3 effects ranked; 0 of ") and texts[5].endswith(" fits made")
    assert "2 effects ranked beside scatter" in texts[-1] and texts[-1].endswith(" fits made; verdict found")
    assert all(line.startswith("0 of 1 jobs done") for line in run.lines()[1:])
    # The end of the job removes its status.
    remove_status(run.log)
    run.take(LogEvent.JOB_FINISHED, job_id=0)
    assert "bench" not in run.lines()[-1] and not list(tmp_path.iterdir())


def test_cached_fits_are_not_counted(tmp_path):
    stored, words = FitCache(tmp_path / "fits", "this recording", lambda effect: "as it is"), []
    for _ in range(2):
        progress = DiagnosisProgress(lambda status: words.append(status.words))
        find_missing_physics("bench", ready(), CANDIDATES, {"default": 0.02}, cache=stored, progress=progress)
    assert words[-1] == "alignment fitted; 2 effects ranked beside scatter; verdict found"
    assert "fits made" in words[words.index("alignment fitted", 1) - 1]


def test_time_left_follows_the_forecast_until_fits_take_longer(tmp_path):
    run = Watched(tmp_path, expected=(1200.0, 4800.0))  # on one core: ten to forty minutes on two
    run.look()
    assert run.lines()[-1] == "0 of 1 jobs done, 8 min to 1.5 h left; now: diagnose (0 of 1 done)"
    run.now = 540.0
    write_status(run.log, JobStatus("bench", "1 of 6 fits made", min_seconds_left=3000.0))
    run.look()
    assert run.lines()[-1] == (
        "0 of 1 jobs done, 50 min to 2 h left; now: diagnose (0 of 1 done); bench: 1 of 6 fits made"
    )
    write_status(run.log, JobStatus("bench", "verdict found", min_seconds_left=0.0, max_seconds_left=100.0))
    run.now += 60.0
    run.look()
    assert run.lines()[-1] == "0 of 1 jobs done, under 2 min left; now: diagnose (0 of 1 done); bench: verdict found"


def test_time_left_is_small_after_the_verdict():
    times = [0.0]
    progress = DiagnosisProgress(clock=lambda: times[-1])
    assert progress.max_seconds_left is None
    times.append(50.0)
    for rounds in (1, 2, 3):
        progress.begin(FITTED, 2)
        assert progress.max_seconds_left == pytest.approx(50 * LEFT_AFTER[FITTED] / rounds)
    times.append(100.0)
    progress.reached(JUDGED)
    assert progress.max_seconds_left == pytest.approx(100 * LEFT_AFTER[JUDGED])
    progress.reached(COMPARED)
    assert progress.max_seconds_left == pytest.approx(100 * LEFT_AFTER[COMPARED])


def test_time_of_remaining_fits_follows_recent_ones():
    times = [0.0]
    progress = DiagnosisProgress(clock=lambda: times[-1])
    assert progress.min_seconds_left is None
    progress.reached(ALIGNED)
    done = progress.begin(FITTED, 4)
    assert progress.min_seconds_left is None
    for now in (10.0, 30.0):
        times.append(now)
        done()
    assert progress.min_seconds_left == pytest.approx(2 * 15.0)
    done()
    done()
    assert progress.min_seconds_left == 0
    times.append(100.0)
    done = progress.begin(FITTED, 3)
    times.append(107.0)
    done()
    assert progress.min_seconds_left == pytest.approx(2 * 7.0)
    assert progress.words == "alignment fitted; 5 of 7 fits made"


def test_status_describes_the_current_step():
    progress = DiagnosisProgress()
    progress.reached(ALIGNED)
    for others in ((), ("xray_crosstalk", "heel")):
        done = progress.begin(RANKED, 2, others)
        done()
    assert progress.words == "alignment fitted; 1 of 2 effects ranked beside X-ray crosstalk and heel"
    done()
    for what in (JUDGED, COMPARED):
        progress.reached(what)
    assert progress.words.endswith("2 effects ranked beside X-ray crosstalk and heel; verdict found; images compared")


def test_old_and_invalid_status_files_are_ignored(tmp_path):
    log = tmp_path / "logs" / "a.log"
    assert read_status(log, 0.0) is None
    write_status(log, JobStatus("bench", "alignment fitted"))
    assert read_status(log, 0.0) == JobStatus("bench", "alignment fitted")
    assert read_status(log, os.stat(status_path(log)).st_mtime + 1) is None  # killed; its last status remains
    for text in ("{", "[]", json.dumps({"name": "bench"}), ""):
        status_path(log).write_text(text)
        assert read_status(log, 0.0) is None
    remove_status(log)
    remove_status(log)
    assert [path.name for path in log.parent.iterdir()] == []


def test_finished_job_leaves_no_status_and_a_missing_one_is_no_error(tmp_path):
    class Script:
        log, threads = [tmp_path / "a.log"], 1

    with job(Script):
        write_status(Script.log[0], JobStatus("bench", "alignment fitted"))
        assert read_status(Script.log[0], 0.0)
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]
    (tmp_path / "file").touch()
    write_status(tmp_path / "file" / "a.log", JobStatus("bench", "alignment fitted"))  # no folder to write to


def test_line_has_the_status_of_a_few_jobs(tmp_path):
    stream = io.StringIO()
    steps = [Step(number, "diagnose", (f"{number}",), log=str(tmp_path / f"{number}.log")) for number in range(6)]
    console = Console(logging.StreamHandler(stream), Progress(steps, 6, dict, 0.0), "logs", clock=lambda: 30.0)
    for step in reversed(steps):
        console.progress.start(step.number, 0.0)
        write_status(step.log, JobStatus(f"bench{step.number}", "alignment fitted"))
    console.emit(logging.makeLogRecord({"event": "time_passed"}))
    assert stream.getvalue().splitlines()[-1].partition("; bench")[2] == (
        "5: alignment fitted; bench4: alignment fitted; bench3: alignment fitted"
    )
