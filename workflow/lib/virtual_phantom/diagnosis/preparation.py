"""A configured recording, made ready for fits, and what is compared of it in images: by its kind."""

from __future__ import annotations

from ..base.errors import InputError
from ..base.streams import Branch
from ..physics.beam.sensors import stated as stated_sensor
from ..physics.beam.spectra import KVP, TUNGSTEN, Anode
from ..recordings.reading import load_recording
from ..recordings.recording import Recording
from .comparison.regions import Scanned
from .comparison.scans import agreement_of_scans
from .images.setting import agreement_of_images, ready_images
from .projections.setting import ready_scans
from .request import DiagnosisRequest, NominalSettings
from .residuals.dataset import Prepared
from .selection.forward_selection import Choice

# {kind of a recording: (how it is made ready, how a model of it is compared in images)}
KINDS = {"projections": (ready_scans, agreement_of_scans), "images": (ready_images, agreement_of_images)}


def ready(asked: DiagnosisRequest, recording: Recording | None = None) -> tuple[Recording, Prepared]:
    """Read a recording and prepare it for fits.

    Parameters
    ----------
    recording : Recording, optional
        Where it was read already.

    Raises
    ------
    InputError
        For a recording of another kind, and a nominal anode or tube voltage that no spectrum is known of.
    """
    recording = recording or load_recording(asked.folder)
    if recording.kind not in KINDS:
        raise InputError(f"{recording.document.path}: holds {recording.kind}, which are diagnosed by comparison")
    return recording, KINDS[recording.kind][0](recording, asked, labels_of(recording))


def labels_of(recording: Recording) -> NominalSettings:
    """What a recording.yaml states of tube and sensor.

    Raises
    ------
    InputError
        For a nominal anode or tube voltage that no spectrum is known of.
    """
    nominal = recording.nominal
    anode = Anode(nominal.get("anode", TUNGSTEN.target), nominal.get("anode_angle_deg", TUNGSTEN.angle_deg))
    target, tube_kvp = anode.target, nominal.get("tube_kvp")
    if target not in KVP or (tube_kvp is not None and not KVP[target][0] <= tube_kvp <= KVP[target][1]):
        ranges = ", ".join(f"{name} {low:g} to {high:g} kV" for name, (low, high) in KVP.items())
        raise InputError(
            f"{recording.document.path}: no spectrum is known of nominal.anode {target} at {tube_kvp} kV, only {ranges}"
        )
    return NominalSettings(anode, tube_kvp, stated_sensor(**nominal.get("sensor", {})))


def agreement(
    recording: Recording,
    prepared: Prepared,
    choice: Choice,
    asked: DiagnosisRequest,
    purpose: Branch,
    scanned: Scanned | None = None,
    practice: bool = False,
) -> dict:
    """Agreement of a model with the repeats held out, in images (images.agreement.agreement).

    Parameters
    ----------
    purpose : Branch
        What simulated noise of projections is drawn for.
    scanned : Scanned, optional
        None for a disc.
    practice : bool, optional
        Whether it is told what effects change in images.
    """
    return KINDS[recording.kind][1](recording, prepared, choice, asked, purpose, scanned, practice)
