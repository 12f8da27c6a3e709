"""Faults for which the library has no effect, each with the best possible verdict.

Strengths follow from the change of the readings in the scans of the suite, as for the other effects.
"""

from __future__ import annotations

import numpy as np

from .hidden_effect import MEAN, NOISE, ROUND, HiddenEffect, sign

# Verdicts are part of the sealed truths: another text changes the published hashes.
LEFT = "something outside of the library is left"
# Faults of the object: the statement that another object was scanned reports them, too.
OF_OBJECT = ("patient_table", "truncated_object", "wrong_insert")
K_EDGES = {"Gd": 0.1, "Sn": 0.3, "W": 0.05}  # filters with a K edge in the beam (50, 29 and 70 keV), mm at strength 1


def _seed(random: np.random.Generator) -> int:
    return int(random.integers(2**31))


def _seeded(setting: str, seed: str):
    return lambda size, random: {setting: size, seed: _seed(random)}


def _breathing(size, random):
    way = random.normal(size=3) * (1.0, 1.0, 0.5)
    way = (size * way / np.linalg.norm(way)).tolist()
    return {"breathing_mm": way, "breathing_per_turn": float(random.uniform(1.5, 4)), "breathing_phase": _phase(random)}


def _phase(random: np.random.Generator) -> float:
    return float(random.uniform(0, 2 * np.pi))


def _swing(size, random):
    return {"swing_deg": size, "swing_per_turn": float(random.uniform(0.7, 3)), "swing_phase": _phase(random)}


def _tile(size, random):
    """A tile of an eighth to a quarter of the columns, in the inner half of the detector."""
    first, width = float(random.uniform(0.25, 0.5)), float(random.uniform(0.125, 0.25))
    return {"tile_px": size * sign(random), "tile_from": first, "tile_to": first + width}


def _dim(size, random):
    return {"dim_share": size, "dim_views": float(random.uniform(0.03, 0.1)), "dim_seed": _seed(random)}


def _warming(size, random):
    return {"warming": size * sign(random), "warming_turns": float(random.uniform(0.2, 0.6))}


def _k_edge(size, random):
    name = str(random.choice(list(K_EDGES)))
    return {"kvp": 120.0, "aluminium_mm": 3.0, "plate": (name, K_EDGES[name] * size)}


def _hard_heel(size, random):
    return {"kvp": float(random.choice([80, 100])), "aluminium_mm": 3.0, "heel_depth_mm": size * sign(random)}


def _table(size, random):
    return {"table_mm": size, "table_hu": float(random.uniform(-300, 100))}


def _arm(size, random):
    return {"arm_radius_mm": size, "arm_side": sign(random), "arm_height_mm": float(random.uniform(-30, 30))}


def _insert(size, random):
    return {"insert_hu": size * sign(random), "insert": float(random.uniform(0, 1))}


def _kind(strengths, make, where, right=LEFT, equals=(), unseen=()):
    return HiddenEffect(
        strengths,
        lambda size, random: (make(size, random), {}),
        where,
        unseen=unseen,
        known=False,
        right=right,
        equals=equals,
    )


MISSING_EFFECTS: dict[str, HiddenEffect] = {
    "periodic_motion": _kind(((0.1, 0.2), (0.4, 0.8), (1.5, 3.0)), _breathing, MEAN),
    "swinging_object": _kind(((0.1, 0.2), (0.4, 0.8), (1.5, 3.0)), _swing, MEAN, unseen=ROUND),
    "timing_jitter": _kind(
        ((0.05, 0.1), (0.2, 0.4), (0.8, 1.5)), _seeded("jitter_deg", "jitter_seed"), MEAN, unseen=ROUND
    ),
    "displaced_tile": _kind(((0.05, 0.1), (0.2, 0.4), (0.6, 1.0)), _tile, MEAN),
    "refraction": _kind(((0.005, 0.01), (0.02, 0.04), (0.06, 0.1)), lambda size, _: {"refraction": size}, MEAN),
    "dim_views": _kind(((0.002, 0.004), (0.01, 0.02), (0.05, 0.1)), _dim, MEAN),
    "lost_views": _kind(((0.02, 0.03), (0.04, 0.06), (0.08, 0.12)), _seeded("lost_views", "lost_seed"), MEAN),
    "gain_drift": _kind(((0.001, 0.002), (0.005, 0.01), (0.02, 0.04)), _warming, MEAN),
    "charge_sharing": _kind(
        ((0.02, 0.04), (0.08, 0.15), (0.2, 0.35)),
        lambda size, _: {"charge_share": size},
        (*MEAN, *NOISE, "noise correlation"),
        "crosstalk of either kind, with or without another flux, is its equal; or " + LEFT,
        tuple((kind, *flux) for kind in ("optical_crosstalk", "xray_crosstalk") for flux in ((), ("photon_flux",))),
    ),
    "k_edge_filter": _kind(
        ((0.5, 0.8), (1.0, 1.5), (2.0, 3.0)),
        _k_edge,
        MEAN,
        "a spectrum filtered by more aluminium is its equal; or " + LEFT,
        (("spectrum",),),
    ),
    "hardening_heel": _kind(
        ((1e-3, 2e-3), (4e-3, 7e-3), (0.012, 0.02)),
        _hard_heel,
        (*MEAN, *NOISE, "white field"),
        "spectrum and heel together are its equal; or " + LEFT,
        (("spectrum", "heel"),),
    ),
    "patient_table": _kind(((0.5, 1.0), (2.0, 4.0), (8.0, 15.0)), _table, MEAN),
    "truncated_object": _kind(((3.0, 5.0), (8.0, 12.0), (16.0, 25.0)), _arm, MEAN),
    "wrong_insert": _kind(((10.0, 20.0), (40.0, 80.0), (150.0, 400.0)), _insert, MEAN),
}
