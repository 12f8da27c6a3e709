"""Candidate measurements: another object, distance, tube current, speed or beam height."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...base.geometry import OrbitGeometry
from ...physics.scenes.objects import read_object
from ...physics.scenes.scene import Scene
from ...physics.scenes.shapes import ShapesScene
from .measurement import OBJECT_KNOWN, DarkFrames, FurtherScan

FILLED = 0.8  # of the field of view, for a large object
OFF_AXIS = 0.6  # of the radius of the field of view, where small objects show the geometry
MAGNIFIED = 2.0  # largest factor by which the object moves towards source or detector
LEAST_MAGNIFIED = 1.2  # smallest factor that counts as another distance
NEAREST = 0.95  # of the distance to the detector
FEW_ROWS = 4  # fraction of the rows in a narrow beam is 1 / FEW_ROWS
OF_CURRENT = ("photons", "tube_current_ma", "mas", "dose_mgy")  # keys of `nominal` proportional to the tube current


def candidate_measurements(geometry: OrbitGeometry, scene: Scene) -> list[FurtherScan | DarkFrames]:
    """Return the measurements that the geometry of a recording allows; the first is the same scan again."""
    again = FurtherScan("same", "the same scan again", scene, geometry)
    found: list[FurtherScan | DarkFrames] = [again, *([] if geometry.parallel else _distances(again))]
    words, nominal = "the same scan at half the tube current", dict.fromkeys(OF_CURRENT, 0.5)
    found.append(replace(again, name="half_current", words=words, photons=0.5, nominal=nominal))
    if geometry.view_interval_ms is not None:
        found.append(_slower(again))
    if narrow := _narrow(again):
        found.append(narrow)
    start_deg = float(np.degrees(geometry.angles_rad[0])) + 180
    turned = {"start_angle_deg": round(start_deg - 360 if start_deg > 360 else start_deg, 6)}
    words, half = "the same scan, begun 180 degrees further", geometry.turned(np.pi)
    found.append(replace(again, name="half_turn", words=words, geometry=half, scan=turned))
    mirrored = replace(geometry, angles_rad=2 * geometry.angles_rad[0] - geometry.angles_rad)
    direction = {"direction": -1 if geometry.angles_rad[1] > geometry.angles_rad[0] else 1}
    words = "the same scan, turning the other way"
    found.append(replace(again, name="other_way", words=words, geometry=mirrored, scan=direction))
    found += _objects(again)
    nothing = {"kind": "ball", "parameters": {"diameter_mm": 1, "material": "air"}}
    section = {"object": nothing, "check_setup": False}
    scene = ShapesScene(read_object(**nothing).shapes)
    found.append(FurtherScan("air", "nothing in the beam, read as a scan", scene, geometry, section=section))
    found.append(DarkFrames("dark_frames", "dark frames before and after the scan"))
    return found


def _distances(again: FurtherScan) -> Iterator[FurtherScan]:
    geometry, radius_mm = again.geometry, again.scene.radius_mm
    source, detector = geometry.source_to_isocentre_mm, geometry.source_to_detector_mm
    nearer = source / MAGNIFIED
    far = min(source * MAGNIFIED, NEAREST * detector)
    for name, place, words in (
        ("magnified", nearer, "the object nearer to the source: {:.2g} times the magnification"),
        ("less_magnified", far, "the object nearer to the detector: {:.2g} times the magnification"),
    ):
        moved = replace(geometry, source_to_isocentre_mm=place)
        factor = source / place
        if max(factor, 1 / factor) >= LEAST_MAGNIFIED and radius_mm <= moved.field_of_view_radius_mm:
            scan = {"source_to_isocentre_mm": round(place, 3)}
            yield replace(again, name=name, words=words.format(factor), geometry=moved, scan=scan)


def _slower(again: FurtherScan) -> FurtherScan:
    geometry = again.geometry
    exposure = None if geometry.exposure_ms is None else 2 * geometry.exposure_ms
    slow = replace(geometry, view_interval_ms=2 * geometry.view_interval_ms, exposure_ms=exposure)
    scan = {"view_interval_ms": 2 * geometry.view_interval_ms, "rotation_time_ms": None}
    if exposure is not None:
        scan["exposure_ms"] = exposure
    words = "the same scan at half the speed and half the tube current, as many photons in each view"
    nominal = {"tube_current_ma": 0.5, "exposure_time_ms": 2.0}
    return replace(again, name="half_speed", words=words, geometry=slow, scan=scan, nominal=nominal)


def _narrow(again: FurtherScan) -> FurtherScan | None:
    """Return a scan of the middle rows, at least two; an even number of rows stays even, and an odd number odd."""
    rows = again.geometry.rows
    left = max(2, rows // FEW_ROWS)
    left += (rows - left) % 2
    if left > rows / 2:
        return None
    narrow = replace(again.geometry, rows=left)
    words = f"the same scan, the beam collimated to the {left} rows in the middle; leave the others out of the file"
    return replace(again, name="narrow_beam", words=words, geometry=narrow, scan={"rows": left})


def _objects(again: FurtherScan) -> Iterator[FurtherScan]:
    geometry = again.geometry
    radius_mm = geometry.field_of_view_radius_mm
    high = geometry.rows * geometry.row_pitch_mm / geometry.magnification
    pixel = geometry.column_pitch_mm / geometry.magnification
    wide, off, tall = round(FILLED * radius_mm), round(OFF_AXIS * radius_mm), 2 * round(high)
    step = max(1, round(radius_mm / 10))
    water = {"diameter_mm": wide * 2 - 20, "wall_mm": 5, "length_mm": max(100, tall)}
    wire = {"diameter_mm": max(0.5, round(2 * pixel, 1)), "x_mm": off, "length_mm": max(35, tall)}
    offered = [
        ("water", "water_cylinder", water),
        ("pmma", "pmma_disc", {"diameter_mm": round(radius_mm / 2)}),
        ("pmma_large", "pmma_disc", {"diameter_mm": 2 * wide}),
        ("catphan_404", "catphan504_ctp404", {}),
        ("catphan_486", "catphan504_ctp486", {}),
        ("acr", "acr464_module1", {}),
        ("wedge", "step_wedge", {"step_mm": step, "tread_mm": max(1, round(high / 5)), "width_mm": 4 * step}),
        ("wire", "wire", wire | {"material": "aluminium"}),
        ("ball", "ball", {"diameter_mm": max(2, round(radius_mm / 10)), "material": "aluminium", "x_mm": off}),
    ]
    for name, kind, parameters in offered:
        shaped = read_object(kind, parameters)
        scene = ShapesScene(shaped.shapes, again.scene.energy_kev)
        if scene.radius_mm > radius_mm:
            continue
        section = {"object": {"kind": kind, "parameters": parameters}, "alignment": dict(OBJECT_KNOWN)}
        values = ", ".join(f"{key} {value}" for key, value in parameters.items())
        words = f"another object: {kind}" + (f" ({values})" if values else "")
        yield replace(again, name=name, words=words, scene=scene, known=dict(OBJECT_KNOWN), section=section)
