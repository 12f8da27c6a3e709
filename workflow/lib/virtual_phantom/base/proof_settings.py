"""Section `proof` of the configuration. Jobs get only the keys that they depend on; the others are None there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageCases:
    """Section `proof.images`: cases whose recordings are images.

    Attributes
    ----------
    effects, tried : tuple of str
        Effects that are hidden, and effects that the diagnosis tries.
    views_times : int
        Number of views, relative to the cases whose recordings are projections.
    """

    strengths: tuple[str, ...]
    effects: tuple[str, ...]
    tried: tuple[str, ...]
    views_times: int


@dataclass(frozen=True)
class ProofProtocol:
    """Section `proof.held_out_protocol`."""

    views: int
    photons: float
    rotation_time_ms: float
    repeats: int


@dataclass(frozen=True)
class ProofScan(ProofProtocol):
    """Section `proof.scan`, whose detector also serves the held-out protocol."""

    columns: int
    rows: int


@dataclass(frozen=True)
class ProofSettings:
    """Section `proof`; `none`, `pairs` and `unknown` are numbers of cases.

    Attributes
    ----------
    declared : int
        Most deviations of a case that the diagnosis is told.
    tried : tuple of str or None
        Effects that the diagnosis of projections tries; None for all that a case can show.
    """

    seed: int
    simulators: tuple[str, ...]
    declared: int
    strengths: tuple[str, ...]
    none: int
    pairs: int
    unknown: int
    images: ImageCases
    recordings: tuple[str, ...]
    scan: ProofScan
    held_out_protocol: ProofProtocol
    effects: tuple[str, ...] | None = None
    unknown_kinds: tuple[str, ...] | None = None
    tried: tuple[str, ...] | None = None
