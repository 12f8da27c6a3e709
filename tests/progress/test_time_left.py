"""Time left, of runs whose jobs take what they are known to take."""

import pytest

from virtual_phantom.study.progress.time_left import Progress, Step, stage_of


def steps(rule, count, first=0, threads=1):
    return [Step(first + i, f"{rule}_{i}", (f"{rule}/{i}",), threads) for i in range(count)]


def rates(*of, seconds):
    return {file: seconds for step in of for file in step.files}


def test_stages_are_rules_without_their_numbers():
    assert stage_of("reconstruct_12") == stage_of("reconstruct_0") == "reconstruct"
    assert stage_of("extract_seeds_00_to_07") == "extract"
    assert stage_of("figure_pca_sirt") == stage_of("figure_rois") == "figures"
    assert stage_of("proof_scan") == "proof_scan"


def test_measured_rates_are_taken_until_a_stage_has_its_own():
    """Twice as slow as expected: from the first job on, the others are expected to be as slow."""
    jobs = steps("reconstruct", 10)
    progress = Progress(jobs, 2, lambda: rates(*jobs, seconds=6.0), began=0.0)
    assert progress.seconds_left(0.0) == (30.0, True)
    progress.start(0, 0.0)
    progress.start(1, 0.0)
    progress.finish(0, 12.0)
    # One is about to end after its 12 s, eight of 12 s each are shared by two cores.
    assert progress.seconds_left(12.0) == (pytest.approx(48.0), True)


def test_jobs_count_by_their_own_size():
    small, large = steps("small", 1), [Step(7, "small_7", ("small/7",))]
    progress = Progress(small + large, 1, lambda: {"small/0": 1.0, "small/7": 9.0}, began=0.0)
    progress.start(0, 0.0)
    progress.finish(0, 2.0)
    assert progress.seconds_left(2.0) == (pytest.approx(18.0), True)


def test_without_a_rate_the_mean_of_the_stage_counts_and_before_it_nothing():
    jobs = steps("diagnose", 4)
    progress = Progress(jobs, 1, dict, began=0.0)
    assert progress.seconds_left(0.0) == (0.0, False)
    progress.start(0, 0.0)
    progress.finish(0, 5.0)
    assert progress.seconds_left(5.0) == (pytest.approx(15.0), True)
    progress.start(1, 5.0)
    assert progress.seconds_left(7.0) == (pytest.approx(13.0), True)


def test_no_job_is_split_and_threads_take_cores():
    long, short = steps("long", 1), steps("short", 2, first=5)
    expected = rates(*long, seconds=60.0) | rates(*short, seconds=3.0)
    assert Progress(long + short, 8, lambda: expected, 0.0).seconds_left(0.0) == (60.0, True)
    wide = steps("wide", 2, threads=4)
    progress = Progress(wide, 4, dict, began=0.0)
    progress.start(0, 0.0)
    progress.finish(0, 10.0)
    assert progress.seconds_left(10.0) == (pytest.approx(10.0), True)


def test_on_a_cluster_as_much_goes_on_at_a_time_as_has_gone_on():
    jobs = steps("reconstruct", 8)
    progress = Progress(jobs, None, dict, began=0.0)
    for number in range(4):
        progress.start(number, 0.0)
        progress.finish(number, 10.0)
    assert progress.seconds_left(10.0) == (pytest.approx(10.0), True)


def test_what_makes_no_file_takes_no_time_and_a_failed_job_is_not_done():
    jobs = [*steps("extract", 2), Step(9, "all", ())]
    progress = Progress(jobs, 1, lambda: rates(*jobs, seconds=4.0), began=0.0)
    progress.start(0, 0.0)
    assert progress.stages() == [("extract", 0, 2)]
    progress.fail(0)
    assert progress.stages() == [] and len(progress.took) == 0
    # It is not waited for, until it is started once more.
    assert progress.seconds_left(3.0) == (4.0, True)
    progress.start(0, 3.0)
    assert progress.seconds_left(3.0) == (8.0, True) and not progress.failed


def test_what_waits_for_a_failed_job_is_not_waited_for():
    jobs = [Step(n, f"step_{n}", (f"step/{n}",), needs=needs) for n, needs in enumerate([(), (0,), (1,), (), (3, 7)])]
    progress = Progress(jobs, 1, lambda: rates(*jobs, seconds=4.0), began=0.0)
    assert progress.lost() == set() and progress.seconds_left(0.0) == (20.0, True)
    progress.start(0, 0.0)
    progress.fail(0)
    assert progress.lost() == {0, 1, 2} and progress.seconds_left(0.0) == (8.0, True)
