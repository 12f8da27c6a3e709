"""Text for the methods section of a paper: the settings and versions of a study in one paragraph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..base.names import enumerated
from ..features.settings import SETTINGS

OBJECTS = {"synthetic": "a synthetic abdomen phantom", "ct": "a CT image", "object": "an object of geometric shapes"}
NOISE = {"physical": "Poisson noise of the counts", "astra": "Poisson noise of ASTRA's add_noise_to_sino"}
SOFTWARE = ("Python", "numpy", "SimpleITK", "snakemake")  # besides pyradiomics, which is named with the features
REFERENCE = "Flouris et al., Sci. Rep. 12, 4732 (2022), doi:10.1038/s41598-022-08301-1"


def how_to_report(config: Mapping, packages: Mapping[str, str], version: str) -> str:
    """Return the paragraph for a study.

    Parameters
    ----------
    config : mapping
        The complete configuration, with defaults.
    packages : mapping of str to str
        {name: version}, with pyradiomics and SOFTWARE.
    """
    sentences = [
        f"We simulated CT scans of {_object(config)} with Virtual Phantom {version} (random seed {config['seed']}).",
        *_scans(config),
        _noise(config),
        _protocols(config),
        _physics(config),
        _features(config, packages["pyradiomics"]),
        *_stability(config),
        f"Software: {', '.join(f'{name} {packages[name]}' for name in SOFTWARE)}. The study follows {REFERENCE}.",
    ]
    return " ".join(sentences)


def _exact(value: float) -> str:
    return f"{value:g}"


def _by(values: Sequence[float]) -> str:
    return " × ".join(map(_exact, values))


def _object(config: Mapping) -> str:
    phantom, grid = config["phantom"], config["grid"]
    text = OBJECTS[phantom["source"]]
    if phantom["source"] == "object":
        text = f"the object {phantom['object']['kind']}"
    return f"{text} on {_by(grid['shape'])} voxels of {_by(grid['spacing_mm'])} mm (z, y, x)"


def _scans(config: Mapping) -> list[str]:
    named = {"": config.get("scan"), **{f" {name}": scan for name, scan in config["scans"].items()}}
    return [_scan(name, scan) for name, scan in named.items() if scan]


def _scan(name: str, scan: Mapping) -> str:
    beam = f"{scan['beam']} beam"
    if scan["beam"] == "divergent":
        beam = (
            f"source-to-isocenter distance {_exact(scan['source_to_isocentre_mm'])} mm, source-to-detector distance "
            f"{_exact(scan['source_to_detector_mm'])} mm"
        )
    pitch = f" with pitch {_exact(scan['pitch'])}" if scan["trajectory"] == "helical" else ""
    return (
        f"Scan{name}: {scan['trajectory']}{pitch}, {beam}, {scan['detector']} detector of {scan['rows']} × "
        f"{scan['columns']} pixels (rows × columns) of {_by((scan['row_pitch_mm'], scan['column_pitch_mm']))} mm."
    )


def _noise(config: Mapping) -> str:
    levels = []
    for name, level in config["noise"]["levels"].items():
        if not level.get("A"):
            amount = "A fitted to the noise of a recording"
        elif config["noise"]["model"] == "physical":
            amount = f"{1 / level['A']:.0f} photons per pixel and view without an object"
        else:
            amount = f"A = 1/I0 = {level['A']:.3g}"
        levels.append(f"{name} ({amount}, {level['repeats']} repeats)")
    text = f"Noise levels ({NOISE[config['noise']['model']]}): {enumerated(levels)}."
    repeats = config["repeats"]
    if repeats["repositioned"]:
        text += (
            f" The last {repeats['repositioned']} repeats were re-positioned by up to {_exact(repeats['shift_mm'])} mm "
            f"and {_exact(repeats['turn_deg'])} degrees."
        )
    return text


def _protocols(config: Mapping) -> str:
    """Name every protocol with its settings; settings that all share come first."""
    parts = {name: _protocol(protocol, config["reconstruction"]) for name, protocol in config["protocols"].items()}
    shared = [part for part in next(iter(parts.values())) if all(part in others for others in parts.values())]
    named: dict[str, list[str]] = {}
    for name, own in parts.items():
        named.setdefault(", ".join(part for part in own if part not in shared), []).append(name)
    texts = [enumerated(names) + (f" ({text})" if text else "") for text, names in named.items()]
    return f"Protocols{f' (all with {enumerated(shared)})' if shared else ''}: {'; '.join(texts)}."


def _protocol(protocol: Mapping, reconstruction: Mapping) -> list[str]:
    parts = [f"{protocol['projections']} projections", "filtered back-projection"]
    if protocol["algorithm"] == "sirt":
        parts[1] = f"{reconstruction['sirt']['iterations']} iterations of SIRT"
    for key, what in (("kernel", "kernel"), ("noise_kernel", "noise kernel")):
        if kernel := protocol.get(key):
            parts.append(f"{what} with MTF50 {_exact(kernel['mtf50_per_cm'])}/cm")
    if voxels := protocol.get("voxels"):
        thickness = _exact(voxels.get("thickness_mm") or voxels["spacing_mm"][0])
        parts += [f"voxels of {_by(voxels['spacing_mm'])} mm (z, y, x)", f"slice thickness {thickness} mm"]
    if scan := protocol.get("scan"):
        parts.append(f"scan {scan}")
    return parts


def _physics(config: Mapping) -> str:
    """Name all effects with their parameters, effects of some protocols, and the diagnoses that effects come from."""
    protocols, effects = config["protocols"].values(), dict(config["physics"])
    recordings = [effects.pop("from", None), *(protocol.get("physics_from") for protocol in protocols)]
    texts = [f"the effects of the diagnosis of {name}" for name in dict.fromkeys(filter(None, recordings))]
    texts += [
        f"{name} ({', '.join(f'{key} = {value}' for key, value in values.items())})" for name, values in effects.items()
    ]
    stated = (protocol.get(stage) or () for protocol in protocols for stage in ("physics", "image_physics"))
    own = {name for names in stated for name in names} - set(effects)
    texts += [f"{name} (in some protocols)" for name in sorted(own)]
    if not texts:
        return "No physical effects other than noise were simulated."
    return f"Simulated physical effects: {enumerated(texts)}."


def _features(config: Mapping, pyradiomics: str) -> str:
    features = config["features"]
    settings = f"the settings of {features['parameters']}"
    if features["parameters"] is None:
        settings = f"a bin width of {_exact(SETTINGS['binWidth'])} HU and no resampling"
    region = "the largest slice of each ROI (2D)" if features["section"] == "largest" else "each ROI (3D)"
    offset = features["stored_offset_hu"]
    shifted = f", with {_exact(offset)} added to HU for texture features" if offset else ""
    return f"Radiomics features of {region} were extracted with pyradiomics {pyradiomics} with {settings}{shifted}."


def _stability(config: Mapping) -> list[str]:
    stability, statistics = config["analyses"].get("stability"), config["statistics"]
    if not stability:
        return []
    groups = sum(protocol.get("group") is not None for protocol in config["protocols"].values())
    noise = stability.get("noise")
    level = f" at noise level {noise if isinstance(noise, str) else enumerated(list(noise))}" if noise else ""
    cut_off = stability["cut_offs"]["w_stability_percent"]
    unit = "ROI" if statistics["compare"] == "roi" else "tissue class"
    robust = (
        "Features were called robust if the 95 % interval of the intraclass correlation (between settings: ICC(2,1), "
        f"between repeats: ICC(1,1); jackknife over ROIs) was at least {_exact(stability['cut_offs']['icc'])} for "
        "every kind of change."
    )
    if groups < 2:
        return [robust]
    return [
        robust,
        f"Stability was the percentage of pairs of {groups} protocol groups in which the repeats of one {unit} had a "
        f"rank-sum statistic |W| < {_exact(statistics['threshold'])}{level}. Features whose 95 % interval was "
        f"at least {_exact(cut_off)} % were called stable.",
    ]
