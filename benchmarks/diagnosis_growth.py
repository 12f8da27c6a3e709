"""Measure the time of a diagnosis as a function of rays, voxels, effects, repeats and cores (7 minutes).

The library's chain simulates scans of the study's phantom with missing scatter. Each is diagnosed in a new Python
process. Writes diagnosis_growth.csv and diagnosis_growth.png with the exponent of each series. Needs idle cores.
"""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks import common
from benchmarks.common.chain_scans import LIBRARY
from benchmarks.diagnosis_rates import Case, run_case, written
from virtual_phantom.figures import style

# The missing effect comes first, so that it is always a candidate. Photon flux needs declared photons.
EFFECTS = ("scatter", *(name for name in LIBRARY if name not in ("scatter", "photon_flux")))
COLUMNS, ROWS, VIEWS, ACROSS = 64, 8, 90, 128
SERIES = {
    "rays": (1, 2, 4, 8),  # factor of the number of views
    "voxels": (64, 128, 256, 384),  # across
    "effects": (3, 9, 27),
    "repeats": (4, 8, 16),
    "cores": (1, 2),
}


def case_of(of, value):
    """Recording of a point of a series, and the number of processes."""
    views = VIEWS * (value if of == "rays" else 1)
    across = value if of == "voxels" else ACROSS
    effects = EFFECTS[: value if of == "effects" else len(EFFECTS)]
    repeats = value if of == "repeats" else 4
    case = Case(f"{of}_{value}", COLUMNS, ROWS, views, ("scatter",), across, effects=effects, repeats=repeats)
    return case, value if of == "cores" else 1


def size_of(of, value, extent):
    return {"rays": extent.rays, "voxels": value**2 * 24}.get(of, value)


def measured(rounds):
    """Rows with quantity, size and median wall time."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for of, values in SERIES.items():
            for value in values:
                case, processes = case_of(of, value)
                place = Path(folder) / case.name
                extent = written(case, place)
                runs = [run_case(place, processes) for _ in range(rounds)]
                seconds = float(np.median([run["wall"] for run in runs]))
                row = {"of": of, "size": size_of(of, value, extent), "seconds": round(seconds, 2)}
                rows.append(row | {"found": "+".join(runs[0]["found"]) or "none"})
                print(rows[-1], flush=True)
    return rows


def exponents(rows):
    """{quantity: fitted exponent}."""
    found = {}
    for of in dict.fromkeys(row["of"] for row in rows):
        size, seconds = np.array([(row["size"], row["seconds"]) for row in rows if row["of"] == of], float).T
        found[of] = float(np.polyfit(np.log(size), np.log(seconds), 1)[0])
    return found


@style.styled(grid=True)
def drawn(rows, powers):
    figure = style.figure(style.DOUBLE_COLUMN_MM, 48)
    axes = figure.subplots(1, len(powers), sharey=True)
    for axis, (of, power) in zip(axes, powers.items(), strict=True):
        size, seconds = np.array([(row["size"], row["seconds"]) for row in rows if row["of"] == of], float).T
        line = np.exp(np.log(seconds).mean() + power * (np.log(size) - np.log(size).mean()))
        axis.loglog(size, line, color="0.6", linewidth=1)
        axis.loglog(size, seconds, "o")
        axis.set(xlabel=of, title=f"power {power:.2f}")
        axis.set_xticks(
            [size[0], size[-1]], [f"{one / 1e6:.2g} M" if one >= 1e4 else f"{one:g}" for one in size[[0, -1]]]
        )
        axis.minorticks_off()
    axes[0].set_ylabel("seconds")
    low, high = (min(row["seconds"] for row in rows), max(row["seconds"] for row in rows))
    ticks = [tick for tick in (5, 10, 20, 50, 100, 200) if low / 1.5 <= tick <= high * 1.5]
    axes[0].set_yticks(ticks, [f"{tick}" for tick in ticks])
    return figure


def add_arguments(parser):
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    parser.add_argument("--rounds", type=int, default=1, help="diagnoses per recording")


def run(options):
    rows = measured(options.rounds)
    powers = exponents(rows)
    table = [row | {"exponent": round(powers[row["of"]], 3)} for row in rows]
    common.write_table(options.out / "diagnosis_growth.csv", table)
    style.save(drawn(rows, powers), [options.out / "diagnosis_growth.png"])
    print({of: round(power, 2) for of, power in powers.items()})
