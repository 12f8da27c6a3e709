"""Run the SLURM profile on a real SLURM: tiny study, failure, resumption, GPUs, no device, and the tutorial.

    .venv/bin/pip install --no-deps -r environment-slurm.txt
    .venv/bin/python tests/cluster/run.py

Run it by hand, as root and with Debian's slurm-wlm and munge. It starts SLURM on one node in a temporary folder and
ends it again. It takes some minutes, prints its findings, and exits with 1 after a failed check.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from runpy import run_path

import pandas as pd
import yaml
from one_node import PRETENDED_GPUS, in_own_mounts, jobs, one_node, running

ROOT = Path(__file__).resolve().parents[2]
# Helpers of tests in another folder, which is not on the import path of a program that is run from here.
PAGES = run_path(str(ROOT / "tests" / "pages.py"))
TINY = ROOT / "config" / "tiny.yaml"


def command(results, *targets, overlay=None):
    """Snakemake with the profile; results and SLURM's logs are in their own folder."""
    files = [TINY]
    if overlay is not None:
        files.append(results.parent / f"{results.name}.yaml")
        files[-1].write_text(yaml.safe_dump(overlay))
    return list(
        map(
            str,
            [
                sys.executable,
                "-m",
                "snakemake",
                *targets,
                "--profile",
                "workflow/profiles/slurm",
                "--nolock",
                "--slurm-init-seconds-before-status-checks",
                5,
                "--slurm-logdir",
            ]
            + [results.parent / "slurm_logs", "--configfile", *files, "--config", f"results_dir={results}"],
        )
    )


def run(environment, results, *targets, overlay=None, more=()):
    """(exit code, all output, seconds, SLURM jobs of this run)."""
    before, began = len(jobs(environment)), time.monotonic()
    done = subprocess.run(
        [*command(results, *targets, overlay=overlay), *more],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=500,
    )
    return done.returncode, done.stdout + done.stderr, time.monotonic() - began, jobs(environment)[before:]


def job_summary(title, seconds, submitted):
    """Describe the jobs of a run in one line."""
    states = pd.Series([job["state"] for job in submitted]).value_counts().to_dict()
    spent = sum(job["run"] or 0 for job in submitted)
    print(f"{title}: {seconds:.0f} s, {len(submitted)} SLURM jobs {states}, {spent:.0f} s in jobs", flush=True)


def study(environment, folder):
    """Run the study; all results are at their paths and a second run has nothing to do."""
    results = folder / "study"
    code, text, seconds, submitted = run(environment, results)
    job_summary("tiny study", seconds, submitted)
    for job in submitted:
        times = f"waited {job['waited']:3.0f} s, ran {job['run']:4.0f} s"
        print(f"    {job['id']:4d} {job['state']:10s} {times}  {job['comment']}")
    expect(code == 0, "the study ends well", text)
    expect(len(pd.read_csv(results / "features.csv")) == 180, "180 rows of features")
    expect(len(list((results / "figures").glob("*.png"))) == 8, "eight figures")
    code, text, seconds, submitted = run(environment, results)
    expect(code == 0 and "Nothing to be done" in text and not submitted, "a second run submits nothing", text)


def failure(environment, folder):
    """The snakemake that submitted a failed job prints the line with the reason."""
    results = folder / "failure"
    rois = [{"name": "a", "tissue_class": "b", "file": "mask.nii.gz"}]
    phantom = {"source": "ct", "ct": {"image": str(folder / "none.nii.gz"), "rois": rois}}
    overlay = {"phantom": phantom, "measured": {"overlay": False}}
    code, text, seconds, submitted = run(environment, results, results / "phantom" / "image.nii.gz", overlay=overlay)
    job_summary("a job that fails", seconds, submitted)
    lines = [line.strip() for line in text.splitlines() if "none.nii.gz" in line and "Failed: " in line]
    print("    " + "\n    ".join(dict.fromkeys(lines)))
    expect(text.splitlines()[-1].startswith("Failed: phantom of "), "and in the last line", text)
    expect(code == 1 and lines, "the failure is told in its own words", text)
    expect(any(job["state"] == "FAILED" for job in submitted), "SLURM counts it as failed")
    expect(not (results / "phantom" / "image.nii.gz").exists(), "nothing is left of it")


def resumption(environment, folder):
    """Kill Snakemake while jobs run, cancel its jobs and run it again: finished jobs are not repeated."""
    results = folder / "resumption"
    targets = [results / "features" / f"{algorithm}_300" / "dose10" / "seed00.csv" for algorithm in ("sirt", "fbp")]
    process = subprocess.Popen(
        command(results, *targets),
        cwd=ROOT,
        env=environment,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    phantom, began = results / "phantom" / "image.nii.gz", time.monotonic()
    before = len(jobs(environment))
    # The second of its jobs, the images, is running.
    while not any(job["state"] == "RUNNING" for job in jobs(environment)[before + 1 :]):
        if process.poll() is not None or time.monotonic() - began > 300:
            raise SystemExit("not so: the images' job runs within 300 s")
        time.sleep(0.5)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    left = running(environment)
    print(f"killed after {time.monotonic() - began:.0f} s; SLURM goes on with jobs {left}")
    subprocess.run(["scancel", *map(str, left)], env=environment, check=True)
    while running(environment):
        time.sleep(0.5)
    made = phantom.stat().st_mtime_ns
    code, text, seconds, submitted = run(environment, results, *targets)
    job_summary("resumed", seconds, submitted)
    expect(code == 0 and all(target.exists() for target in targets), "it is finished", text)
    expect(phantom.stat().st_mtime_ns == made, "the phantom is not made again")
    expect(not list(results.rglob(".partial-*")), "nothing half written is left")


def graphics(environment, folder):
    """Jobs that need a GPU get one, also in a group. SLURM counts GPUs that do not exist here."""
    results = folder / "graphics"
    targets = [
        results / "features" / f"{name}_{views}" / "dose10" / "seed00.csv"
        for name in ("sirt", "fbp")
        for views in (150, 300)
    ]
    rules = [f"reconstruct_{number}:gpu=1" for number in range(3)]
    code, text, seconds, submitted = run(environment, results, *targets, more=["--set-resources", *rules])
    job_summary("images with a GPU", seconds, submitted)
    requested = {job["comment"].split("_")[1]: job["gpus"] for job in submitted}
    print(f"    asked for: {requested}")
    expect(code == 0 and all(target.exists() for target in targets), "it ends well", text)
    expect(
        requested["acquisitions"].endswith("gpu:1") and "gpu" not in requested["preparation"],
        "one GPU for the images alone",
    )


def no_device(environment, folder):
    """Submit engine: astra_cuda from a node that seems to have a device to a node without one.

    Jobs that need no device succeed. The job that needs one waits for a GPU that SLURM counts, gets it, and reports
    that there is no device.
    """
    results = folder / "no_device"
    overlay = {"engine": "astra_cuda", "reconstruction": {"sirt": {"backprojector": "voxel"}}}
    paths = [str(_seeming_device(folder / "seeming")), *filter(None, [environment.get("PYTHONPATH")])]
    pretending = environment | {"PYTHONPATH": os.pathsep.join(paths)}
    clean, kernels = results / "projections" / "views300" / "clean.h5", results / "logs" / "kernels" / "project_1.txt"
    code, text, seconds, prepared = run(pretending, results, clean, kernels, overlay=overlay)
    job_summary("preparation with engine: astra_cuda", seconds, prepared)
    expect(code == 0 and clean.exists(), "what needs no device is done without one", text)
    expect(not any("gpu" in job["gpus"] for job in prepared), "and asked for none")
    # All GPUs that SLURM counts are in use.
    gpu_option = f"--gpus={len(PRETENDED_GPUS)}"
    holder = ["sbatch", "--parsable", gpu_option, "--mem=10", "--output=/dev/null", "--wrap=sleep 600"]
    number = subprocess.run(holder, env=environment, check=True, capture_output=True, text=True).stdout.strip()
    before = len(jobs(environment))
    targets = [results / "features" / "fbp_300" / "dose10" / "seed00.csv", results / "projections/views150/clean.h5"]
    # One bundle per job, so that each requests its own resources.
    alone = ["--group-components", "acquisitions=1", "--keep-going"]
    began = time.monotonic()
    with open(folder / "no_device.txt", "w+", encoding="utf-8") as output:
        process = subprocess.Popen(
            command(results, *targets, overlay=overlay) + alone,
            cwd=ROOT,
            env=pretending,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
        while not (waits := _left_waiting(jobs(environment)[before:])) or not targets[1].exists():
            if process.poll() is not None or time.monotonic() - began > 400:
                output.seek(0)
                expect(False, "a job waits for a GPU while the other one ends", output.read())
            time.sleep(0.5)
        _print_of_job(environment, waits["id"], ("JobState=", "TresPerJob="))
        expect("Reason=Resources" in _job(environment, waits["id"]), "it waits for resources, the other one has ended")
        subprocess.run(["scancel", number], env=environment, check=True)
        # SLURM reports the resources of a job only while it runs.
        while "JobState=RUNNING" not in (record := _job(environment, waits["id"])) and process.poll() is None:
            time.sleep(0.2)
        expect("GRES=gpu:1(IDX:" in record, "once there is one, it is given one", record)
        process.wait(400)
        output.seek(0)
        text = output.read()
    submitted = jobs(environment)[before:]
    job_summary("images with engine: astra_cuda", time.monotonic() - began, submitted)
    _print_of_job(environment, waits["id"], ("JobState=", "ExitCode=", "TimeLimit="))
    lines = dict.fromkeys(line.strip() for line in text.splitlines() if "engine: astra_cuda needs a CUDA" in line)
    print("    " + "\n    ".join(lines))
    failed = [job for job in submitted if job["state"] == "FAILED"]
    expect([job["id"] for job in failed] == [waits["id"]], "it alone has failed", text)
    requested = [job["id"] for job in submitted if "gpu" in job["gpus"]]
    expect(
        requested == [waits["id"]] and failed[0]["gpus"].endswith("gpu:1"), "it alone asked for a GPU, for one", text
    )
    expect(process.returncode == 1 and lines, "where there is no device, a line says so", text)
    expect(targets[1].exists() and not targets[0].exists(), "projections are there, images are not", text)


def _seeming_device(folder):
    """Folder for PYTHONPATH with which ASTRA reports a device outside of SLURM's jobs."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(
        "import os\nif 'SLURM_JOB_ID' not in os.environ:\n    import astra\n    astra.use_cuda = lambda: True\n"
    )
    return folder


def _left_waiting(submitted):
    """The job that waits after all others have succeeded, or None."""
    others = [job for job in submitted if job["state"] != "COMPLETED"]
    return others[0] if len(others) == 1 and others[0]["state"] == "PENDING" else None


def _job(environment, number):
    """Controller's record of a job."""
    requested = ["scontrol", "show", "job", "-d", str(number)]
    return subprocess.run(requested, env=environment, check=True, capture_output=True, text=True).stdout


def _print_of_job(environment, number, keys):
    for line in _job(environment, number).splitlines():
        if any(key in line for key in keys):
            print(f"    {line.strip()}", flush=True)


def tutorial(environment, folder):
    """Follow docs/how-to/cluster.md in a copy of the project."""
    project, before, began = folder / "tutorial", len(jobs(environment)), time.monotonic()
    PAGES["copy_project"](ROOT, project)
    PAGES["follow"](project / "docs" / "how-to" / "cluster.md", project, slurm=True)
    job_summary("the tutorial", time.monotonic() - began, submitted := jobs(environment)[before:])
    expect(submitted and {job["state"] for job in submitted} == {"COMPLETED"}, "SLURM completed all of its jobs")


def expect(true, what, text=""):
    """Exit with a message if the condition is false."""
    if not true:
        print(text[-6000:])
        raise SystemExit(f"not so: {what}")
    print(f"    {what}", flush=True)


SCENARIOS = {one.__name__: one for one in (study, failure, resumption, graphics, no_device, tutorial)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", metavar="|".join(SCENARIOS), help="all by default")
    options = parser.parse_args()
    in_own_mounts()
    # So that the daemons are ended too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended from outside"))
    with tempfile.TemporaryDirectory(prefix="one_node_") as name, one_node(Path(name) / "slurm") as environment:
        for scenario in options.scenarios or SCENARIOS:
            SCENARIOS[scenario](environment, Path(name))
    print(f"load of the machine over the last 15 minutes {os.getloadavg()[2]:.1f}, {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
