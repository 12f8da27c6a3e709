"""Names, colors and files common to all figures."""

import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pandas
import pytest

from virtual_phantom.base.errors import InputError
from virtual_phantom.figures import overlap as overlap_figure
from virtual_phantom.figures import stability_discrimination, style, tables


def luminance(colour):
    """Relative luminance (WCAG 2.1) of an sRGB color in 0 to 1."""
    channel = np.array(matplotlib.colors.to_rgb(colour))
    linear = np.where(channel <= 0.04045, channel / 12.92, ((channel + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("normal_liver", "normal liver"),
        ("sirt_450", "SIRT 450"),
        ("xray_crosstalk", "X-ray crosstalk"),
        ("hu_calibration", "HU calibration"),
        ("aorta", "aorta"),
        ("a$b$_c", "a$b$ c"),
        (7, "7"),
    ],
)
def test_label(name, written):
    assert style.label(name) == written


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("original_glcm_Idn", "GLCM Idn"),
        ("original_firstorder_90Percentile", "First order 90Percentile"),
        ("glszm_ZoneEntropy", "GLSZM ZoneEntropy"),
        ("volume", "volume"),
    ],
)
def test_feature_label(name, written):
    assert style.feature_label(name) == written


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (1488.2, "1488"),
        (149.2, "149"),
        (0.012345, "0.0123"),
        (-3.0, "−3"),
        (2e-5, "0.00002"),
        (999.9, "1000"),
        (0, "0"),
    ],
)
def test_number(value, written):
    assert style.number(value) == written


@pytest.mark.parametrize(
    ("values", "factor", "written"),
    [
        ([1e-4], 1e-4, "10⁻⁴"),
        ([0.8e-4, 1e-4, 1.2e-4], 1e-4, "10⁻⁴"),
        ([2.5e-3], 1e-3, "10⁻³"),
        ([12.0], 10.0, "10¹"),
    ],
)
def test_power_of_ten(values, factor, written):
    found, text = style.power_of_ten(values)
    assert found == pytest.approx(factor) and text == written


def test_markers_repeat_for_many_names():
    assigned = style.assign([f"roi_{index}" for index in range(20)], style.MARKERS)
    assert len(assigned) == 20
    assert assigned["roi_0"] == assigned[f"roi_{len(style.MARKERS)}"]
    assert len({assigned[f"roi_{index}"] for index in range(len(style.MARKERS))}) == len(style.MARKERS)


@pytest.mark.parametrize("colours", ["Blues", "RdBu_r"])
def test_letters_on_a_heat_map_contrast_with_their_cells(colours):
    values = pandas.DataFrame(np.linspace(-1, 1, 60).reshape(6, 10)).mask(lambda cell: cell > 0.95)
    words = values.map(style.number)
    with style.styled():
        axes = style.figure(100, 100).subplots()
        mesh = style.heat_map(axes, values, words, cmap=colours, vmin=-1, vmax=1)
    assert [text.get_text() for text in axes.texts] == words.to_numpy()[values.notna()].tolist()
    for text in axes.texts:
        column, row = (int(place) for place in text.get_position())
        light, dark = sorted(map(luminance, (text.get_color(), mesh.to_rgba(values.iloc[row, column]))), reverse=True)
        assert (light + 0.05) / (dark + 0.05) > 3  # WCAG 2.1


def test_png_and_pdf_are_reproducible(overlap, tmp_path):
    for run in ("first", "second"):
        style.save(overlap_figure.draw(overlap), [tmp_path / run / "a.png", tmp_path / run / "a.pdf"])
    for name, magic in (("a.png", b"\x89PNG"), ("a.pdf", b"%PDF")):
        first, second = ((tmp_path / run / name).read_bytes() for run in ("first", "second"))
        assert first == second
        assert first.startswith(magic)
        assert b"CreationDate" not in first
    assert b"/FontType 3" not in (tmp_path / "first" / "a.pdf").read_bytes()
    width, height = matplotlib.image.imread(tmp_path / "first" / "a.png").shape[1::-1]
    assert width == int(style.DOUBLE_COLUMN_MM / 25.4 * 200)


def test_other_processes_and_hash_seeds_write_the_same_files(tmp_path):
    program = (
        "import sys, pandas, matplotlib;"
        "settings = lambda: {k: v for k, v in matplotlib.rcParams.items() if k != 'backend'};"
        "before = settings(); from virtual_phantom.figures import stability_discrimination as s, style;"
        "style.save(s.draw(pandas.read_csv(sys.argv[1]), 1.0), sys.argv[2:]);"
        "assert settings() == before; import matplotlib.pyplot as plt; assert not plt.get_fignums()"
    )
    table = pandas.DataFrame(
        {
            "feature": ["original_glcm_A", "original_gldm_B"],
            "family": ["glcm", "gldm"],
            "stability_percent": [10.0, 20.0],
            "discrimination_percent": [90.0, 80.0],
        }
    )
    table.to_csv(tmp_path / "table.csv", index=False)
    here, there = ([tmp_path / place / f"a.{kind}" for kind in ("png", "pdf")] for place in ("here", "there"))
    style.save(stability_discrimination.draw(table, 1.0), here)
    subprocess.run(
        [sys.executable, "-c", program, tmp_path / "table.csv", *there],
        check=True,
        env={
            "PYTHONPATH": str(Path(style.__file__).parents[2]),
            "PYTHONHASHSEED": "3",
            "MPLCONFIGDIR": str(tmp_path / "mpl"),
        },
    )
    for one, other in zip(here, there, strict=True):
        assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("kind", ["overlap", "stability"])  # legends below and above
def test_trial_banner_leaves_the_figure_unchanged(overlap, stability, tmp_path, kind):
    def drawn():
        return overlap_figure.draw(overlap) if kind == "overlap" else stability_discrimination.draw(stability, 1.0)

    style.save(drawn(), [tmp_path / "whole.png"])
    style.save(drawn(), [tmp_path / "trial.png"], trial=True)
    whole, trial = (matplotlib.image.imread(tmp_path / f"{name}.png") for name in ("whole", "trial"))
    strip = len(trial) - len(whole)
    assert strip == pytest.approx(style.TRIAL_MM / style.MILLIMETRES_PER_INCH * style.DOTS_PER_INCH, abs=2)
    assert (trial[:strip] < 0.9).any()  # the text
    # Text is positioned at fractions of pixels, which the strip may shift.
    assert (np.abs(trial[strip:] - whole) > 0.5).mean() < 0.002


def test_failed_write_keeps_the_old_files(overlap, tmp_path, monkeypatch):
    figure = overlap_figure.draw(overlap)
    (tmp_path / "a.png").write_text("old")
    whole = type(figure).savefig

    def fail_on_pdf(self, path, **options):
        if options["format"] == "pdf":
            Path(path).write_text("half")
            raise OSError("disk full")
        whole(self, path, **options)

    monkeypatch.setattr(type(figure), "savefig", fail_on_pdf)
    with pytest.raises(OSError, match="disk full"):
        style.save(figure, [tmp_path / "a.png", tmp_path / "a.pdf"])
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_text() == "old"


def test_unknown_format_is_rejected_before_writing(overlap, tmp_path):
    with pytest.raises(ValueError, match="svg"):
        style.save(overlap_figure.draw(overlap), [tmp_path / "a.png", tmp_path / "a.svg"])
    assert not list(tmp_path.iterdir())


def test_user_matplotlib_style_has_no_effect_and_is_kept(overlap, tmp_path):
    style.save(overlap_figure.draw(overlap), [tmp_path / "a.png"])
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "yellow"}):
        style.save(overlap_figure.draw(overlap), [tmp_path / "b.png"])
        assert matplotlib.rcParams["font.size"] == 20
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_check_table():
    table = pandas.DataFrame({"roi": ["a", "b"], "pc1": [1.0, np.nan]})
    tables.check_table(table, "table", text=["roi"])
    with pytest.raises(InputError, match="lacks the column pc2"):
        tables.check_table(table, "table", numbers=["pc2"])
    with pytest.raises(InputError, match="no rows"):
        tables.check_table(table.iloc[:0], "table", text=["roi"])
    with pytest.raises(InputError, match="column pc1 is not a finite number in row 2"):
        tables.check_table(table, "table", numbers=["pc1"])


@pytest.mark.parametrize(
    ("family", "written"),
    [("firstorder", "First order"), ("first_order", "First order"), ("glcm", "GLCM"), ("GLSZM", "GLSZM")],
)
def test_family_label(family, written):
    assert style.family_label(family) == written
