"""Time left: closed forms, and simulated runs with known times."""

import math

import numpy as np
import pytest

from virtual_phantom.study.progress import load
from virtual_phantom.study.progress.time_left import (
    JOB_SD,
    LEAST_SD,
    RUN_SD,
    SLOWER,
    STAGE_SD,
    WIDE,
    Progress,
    Step,
    stage_of,
)


def steps(rule, count, first=0, threads=1):
    return [Step(first + i, f"{rule}_{i}", (f"{rule}/{i}",), threads) for i in range(count)]


def rates(*of, seconds):
    return {file: seconds for step in of for file in step.files}


def middle(low, high):
    return math.sqrt(low * high)


def test_stages_are_rules_without_their_numbers():
    assert stage_of("reconstruct_12") == stage_of("reconstruct_0") == "reconstruct"
    assert stage_of("extract_3") == "extract"
    assert stage_of("figure_pca_sirt") == stage_of("figure_rois") == "figures"
    assert stage_of("proof_scan") == "proof_scan"


@pytest.mark.parametrize("busy", [1.0, 4.0])
def test_range_before_any_job_is_that_of_runs_on_other_machines(busy):
    """A lognormal range, scaled by the machine's load, with unchanged width."""
    job = steps("reconstruct", 1)
    low, high, complete = Progress(job, 1, lambda: rates(*job, seconds=60.0), 0.0, busy).range_left(0.0)
    assert complete and middle(low, high) == pytest.approx(60 * SLOWER * busy)
    assert math.log(high / low) == pytest.approx(2 * WIDE * math.hypot(RUN_SD, STAGE_SD))


def test_uncertainty_of_a_job_widens_its_range():
    job = steps("diagnose", 1)
    low, high, _ = Progress(job, 1, lambda: rates(*job, seconds=(20.0, 180.0)), 0.0).range_left(0.0)
    assert middle(low, high) == pytest.approx(60 * SLOWER)
    log_sd = math.log(9) / (2 * WIDE)
    assert math.log(high / low) == pytest.approx(2 * WIDE * math.sqrt(RUN_SD**2 + STAGE_SD**2 + log_sd**2))


def test_finished_jobs_count_by_their_number():
    """Three times slower than expected: one job moves the estimate in part, many determine it."""
    jobs = steps("reconstruct", 101)
    progress = Progress(jobs, 1, lambda: rates(*jobs, seconds=6.0), began=0.0)
    found = []
    for number in range(100):
        if number in (0, 1, 10):
            found.append(progress.range_left(18.0 * number))
        progress.start(number, 18.0 * number)
        progress.finish(number, 18.0 * (number + 1))
    found.append(progress.range_left(1800.0))
    jobs_left = (101, 100, 91, 1)
    seconds = [middle(low, high) / left for (low, high, _), left in zip(found, jobs_left, strict=True)]
    assert seconds[0] == pytest.approx(6 * SLOWER) and seconds == sorted(seconds)
    # The prior of the stage has the variances of the run and of the stage; the job itself has JOB_SD^2.
    prior, job = RUN_SD**2 + STAGE_SD**2, JOB_SD**2
    run = math.log(SLOWER) + RUN_SD**2 / (prior + job) * math.log(3 / SLOWER)
    left = RUN_SD**2 * (1 - RUN_SD**2 / (prior + job)) + STAGE_SD**2
    assert seconds[1] == pytest.approx(6 * math.exp(run + left / (left + job) * (math.log(3) - run)))
    assert seconds[3] == pytest.approx(18.0, rel=0.02)
    widths = [math.log(high / low) for low, high, _ in found]
    assert widths == sorted(widths, reverse=True) and widths[3] == pytest.approx(2 * WIDE * LEAST_SD)


def test_stage_without_finished_jobs_has_the_pace_of_the_others():
    first, second = steps("reconstruct", 40), steps("extract", 1, first=40)
    progress = Progress(first + second, 1, lambda: rates(*first, *second, seconds=6.0), began=0.0)
    for number in range(40):
        progress.start(number, 24.0 * number)
        progress.finish(number, 24.0 * (number + 1))
    low, high, _ = progress.range_left(960.0)
    assert 6 * 2.5 < middle(low, high) < 24 and math.log(high / low) < 2 * WIDE * math.hypot(RUN_SD, STAGE_SD)


def test_running_job_is_one_of_those_that_take_longer():
    """Quantiles of a lognormal beyond a time, by simulation."""
    job = steps("diagnose", 1)
    progress = Progress(job, 1, lambda: rates(*job, seconds=100.0), began=0.0)
    progress.start(0, 0.0)
    low, high, _ = progress.range_left(80.0)
    drawn = np.random.default_rng(3).lognormal(math.log(100 * SLOWER), math.hypot(RUN_SD, STAGE_SD), 400_000)
    np.testing.assert_allclose((low, high), np.quantile(drawn[drawn > 80.0], (0.1, 0.9)) - 80.0, rtol=0.02)
    # The longer it takes, the longer it is expected to take.
    late = [progress.range_left(seconds)[1] for seconds in (300.0, 1e3, 1e5)]
    assert late == sorted(late) and late[-1] <= 1e5


def test_ranges_cover_the_truth_at_their_level():
    """Eight of ten runs, before the first job and in the middle, for runs drawn from the assumed distribution."""
    random, held_out = np.random.default_rng(5), {0: 0, 30: 0}
    for _ in range(150):
        jobs = [step for stage in range(4) for step in steps(f"stage{stage}", 15, first=15 * stage)]
        random.shuffle(jobs)
        expected = {step.files[0]: 10.0 * 2 ** (step.number % 3) for step in jobs}
        slower = SLOWER * random.lognormal(0, RUN_SD)
        of_stage = {step.stage: random.lognormal(0, STAGE_SD) for step in jobs}
        takes = [expected[s.files[0]] * slower * of_stage[s.stage] * random.lognormal(0, JOB_SD) for s in jobs]
        progress, now = Progress(jobs, 1, lambda expected=expected: expected, began=0.0), 0.0
        for done, (step, seconds) in enumerate(zip(jobs, takes, strict=True)):
            if done in held_out:
                low, high, _ = progress.range_left(now)
                held_out[done] += low <= sum(takes[done:]) <= high
            progress.start(step.number, now)
            now += seconds
            progress.finish(step.number, now)
    assert all(0.75 < count / 150 < 0.97 for count in held_out.values()), held_out


def test_jobs_without_a_rate_use_the_mean_of_their_stage():
    jobs = steps("diagnose", 4)
    progress = Progress(jobs, 1, dict, began=0.0)
    assert progress.range_left(0.0) == (0.0, 0.0, False)
    progress.start(0, 0.0)
    progress.finish(0, 5.0)
    low, high, complete = progress.range_left(5.0)
    assert complete and middle(low, high) == pytest.approx(15.0)


def test_jobs_are_not_split_and_dependent_jobs_come_later():
    chain = [Step(n, f"step_{n}", (f"step/{n}",), needs=(n - 1,) if n else ()) for n in range(3)]
    one = [Step(9, "other_0", ("other/0",))]
    expected = rates(*chain, *one, seconds=60.0)
    alone = Progress(one, 8, lambda: expected, 0.0).range_left(0.0)
    together = Progress(chain + one, 8, lambda: expected, 0.0).range_left(0.0)
    assert together[0] == pytest.approx(3 * alone[0])
    # Graham's bound: all work divided by eight cores, and seven eighths of the longest chain.
    assert together[1] == pytest.approx(alone[1] / (1 / 8 + 7 / 8) * (4 / 8 + 3 * 7 / 8))
    wide = steps("wide", 2, threads=4)
    progress = Progress(wide, 4, dict, began=0.0)
    progress.start(0, 0.0)
    progress.finish(0, 10.0)
    low, high, _ = progress.range_left(10.0)
    assert low < 10.0 < high


def test_parallel_jobs_of_a_cluster_are_estimated_from_the_past():
    jobs = steps("reconstruct", 8)
    progress = Progress(jobs, None, dict, began=0.0)
    for number in range(4):
        progress.start(number, 0.0)
        progress.finish(number, 10.0)
    low, high, _ = progress.range_left(10.0)
    assert low < 10.0 < high  # four jobs at a time, as before
    assert low == pytest.approx(10.0 * math.exp(-WIDE * math.hypot(JOB_SD / 2, LEAST_SD)))


def test_job_without_output_takes_no_time_and_failed_job_is_not_done():
    jobs = [*steps("extract", 2), Step(9, "all", ())]
    progress = Progress(jobs, 1, lambda: rates(*jobs, seconds=4.0), began=0.0)
    progress.start(0, 0.0)
    assert progress.stages() == [("extract", 0, 2)]
    progress.fail(0)
    assert progress.stages() == [] and len(progress.took) == 0
    # It is not waited for until it is restarted.
    one = progress.range_left(3.0)
    assert middle(*one[:2]) == pytest.approx(4.0 * SLOWER)
    progress.start(0, 3.0)
    both = progress.range_left(3.0)
    assert both[0] == pytest.approx(2 * one[0]) and both[1] == pytest.approx(2 * one[1]) and not progress.failed


def test_jobs_that_depend_on_a_failed_job_are_not_waited_for():
    jobs = [Step(n, f"step_{n}", (f"step/{n}",), needs=needs) for n, needs in enumerate([(), (0,), (1,), (), (3, 7)])]
    progress = Progress(jobs, 1, lambda: rates(*jobs, seconds=4.0), began=0.0)
    assert progress.lost() == set() and middle(*progress.range_left(0.0)[:2]) == pytest.approx(20 * SLOWER)
    progress.start(0, 0.0)
    progress.fail(0)
    assert progress.lost() == {0, 1, 2} and middle(*progress.range_left(0.0)[:2]) == pytest.approx(8 * SLOWER)


@pytest.mark.parametrize(
    "average, cores, slower",
    [(0.0, 2, 1.0), (1.0, 2, 1.0), (7.0, 2, 4.0), (3.0, 1, 1.5), (7.0, None, 1.0)],
)
def test_other_processes_take_their_share_of_the_cores(average, cores, slower, monkeypatch):
    """Two cores; one process of the load average is the start of this run."""
    monkeypatch.setattr(load.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(load, "available", lambda: 2.0)
    monkeypatch.setattr(load, "load_average", lambda: average)
    assert load.slowdown(cores) == pytest.approx(slower)


def test_processes_beyond_the_usable_cores_share_them(monkeypatch, tmp_path):
    monkeypatch.setattr(load.os, "cpu_count", lambda: 16)
    monkeypatch.setattr(load, "load_average", lambda: 0.0)
    monkeypatch.setattr(load.os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert load.available(tmp_path) == 8
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert load.available(tmp_path) == 8
    (tmp_path / "cpu.max").write_text("150000 100000\n")
    assert load.available(tmp_path) == 1.5
    (tmp_path / "cpu.max").unlink()
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu" / "cpu.cfs_quota_us").write_text("200000\n")
    (tmp_path / "cpu" / "cpu.cfs_period_us").write_text("100000\n")
    assert load.available(tmp_path) == 2
    monkeypatch.setattr(load, "available", lambda: 2.0)
    assert load.slowdown(4) == 2
