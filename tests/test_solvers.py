"""SIRT and FDK of a water cylinder with inserts, and Chebyshev against plain SIRT."""

import numpy as np
import pytest
from scipy import special

from virtual_phantom.base.errors import InputError
from virtual_phantom.base.geometry import Grid, circular, helical
from virtual_phantom.io.schema import defaults_of
from virtual_phantom.projectors.cpu import CpuProjector
from virtual_phantom.reconstruction import fbp, sirt

MU = 0.02
SIRT = defaults_of("reconstruction", "sirt")
SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0, column_pitch_mm=8.0, row_pitch_mm=8.0)
GRID = Grid((12, 64, 64), (4.0, 4.4, 4.4))
GEOMETRIES = {
    "circular": circular(views=120, columns=72, rows=16, **SCANNER),
    "helical": helical(views=160, volume_height_mm=48, columns=72, rows=12, **SCANNER),
}
# Trajectories for the rebinning of filtered back-projection.
UNUSUAL = {
    "one and a quarter turns": circular(views=150, turns=1.25, columns=72, rows=16, **SCANNER),
    "two turns": circular(views=240, turns=2, columns=72, rows=16, **SCANNER),
    "three quarters of a turn": circular(views=90, turns=0.75, columns=72, rows=16, **SCANNER),
    "clockwise": circular(views=120, direction=-1, columns=72, rows=16, **SCANNER),
    "detector shifted": circular(views=120, columns=76, rows=16, column_offset_px=1.3, row_offset_px=0.4, **SCANNER),
    "helix of four rows": helical(views=400, volume_height_mm=48, columns=72, rows=4, **SCANNER),
    "helix of half the pitch": helical(views=400, volume_height_mm=48, pitch=0.5, columns=72, rows=8, **SCANNER),
    "arc": circular(views=120, columns=72, rows=16, surface="cylindrical", **SCANNER),
    "helix, arc, flying focal spot": helical(
        views=480,
        volume_height_mm=48,
        columns=72,
        rows=12,
        surface="cylindrical",
        spots_mm=[(along, 50 * z, z) for z in (-0.6, 0.6) for along in (-2.0, 2.0)],
        **SCANNER,
    ),
}


def inserts():
    """{name: (x, y, radius mm, HU)} of four rods in a water cylinder of 110 mm radius, one far off the axis."""
    return {
        "bone": (50.0, 0.0, 22.0, 200.0),
        "fat": (-50.0, 0.0, 22.0, -200.0),
        "soft": (0.0, 55.0, 20.0, 60.0),
        "far": (-55.0, -66.0, 20.0, 100.0),
    }


def cylinder(grid):
    z, y, x = grid.axes_mm()
    hu = np.where(x**2 + y[:, None] ** 2 < 110**2, 0.0, -1000.0)
    for cx, cy, radius, value in inserts().values():
        hu[(x - cx) ** 2 + (y[:, None] - cy) ** 2 < radius**2] = value
    return np.repeat(hu[None], grid.shape[0], 0).astype(np.float32)


def project(geometry, grid=GRID, finer=3):
    """Line integrals of the cylinder from a finer grid than the one reconstructed on."""
    fine = grid.refined(finer)
    projector = CpuProjector(geometry, fine)
    volume = projector.pack_volume(((cylinder(fine) / 1000 + 1) * np.float32(MU))[None])
    return projector.unpack_projections(projector.forward(volume))


@pytest.fixture(scope="module", params=list(GEOMETRIES))
def scan(request):
    geometry = GEOMETRIES[request.param]
    return request.param, geometry, project(geometry)


@pytest.mark.parametrize("algorithm", ["fdk", "sirt"])
def test_water_is_0_hu_and_inserts_have_their_attenuation(scan, algorithm):
    """Water within 3 HU, inserts within 1 % of their attenuation, away from edges and from the end slices."""
    _, geometry, line_integrals = scan
    projector = CpuProjector(geometry, GRID)
    image = fbp.fbp(projector, line_integrals) if algorithm == "fdk" else sirt.sirt(projector, line_integrals, **SIRT)
    check_cylinder(image[0])


@pytest.mark.parametrize("geometry", UNUSUAL.values(), ids=UNUSUAL.keys())
def test_fbp_of_other_trajectories(geometry):
    check_cylinder(fbp.fbp(CpuProjector(geometry, GRID), project(geometry))[0])


def check_cylinder(image):
    """Water within 3 HU in rings and quadrants, so that no shading is averaged out; inserts within 1 %."""
    hu = (image / MU - 1) * 1000
    _, y, x = GRID.axes_mm()
    radius, quadrant = np.hypot(x, y[:, None]), (x > 0) + 2 * (y[:, None] > 0)
    water = radius < 98
    middle = slice(4, 8)
    for cx, cy, size, value in inserts().values():
        distance = np.hypot(x - cx, y[:, None] - cy)
        water &= distance > size + 12
        assert hu[middle][:, distance < size - 8].mean() == pytest.approx(value, abs=0.01 * (1000 + value))
    parts = [water & (radius >= low) & (radius < high) for low, high in ((0, 30), (30, 60), (60, 80), (80, 98))]
    parts += [water & (quadrant == number) for number in range(4)]
    for part in parts:
        assert part.sum() > 20
        assert abs(hu[middle][:, part].mean()) < 3


@pytest.mark.parametrize("backprojector", ["adjoint", "voxel"])
def test_chebyshev_equals_plain_sirt(backprojector):
    """The images after 500 iterations differ by at most 0.5 % of the noise SD, for circular and helical scans."""
    grid = Grid((6, 24, 24), (8.0, 11.0, 11.0))
    for geometry in (
        circular(views=40, columns=36, rows=8, **(SCANNER | dict(column_pitch_mm=16.0, row_pitch_mm=16.0))),
        helical(
            views=50,
            volume_height_mm=48,
            columns=36,
            rows=5,
            **(SCANNER | dict(column_pitch_mm=16.0, row_pitch_mm=16.0)),
        ),
    ):
        clean = project(geometry, grid, 2)[0]
        random = np.random.default_rng(3)
        noisy = np.stack([clean, *(clean + random.normal(0, 0.02, clean.shape) for _ in range(2))]).astype(np.float32)
        projector = CpuProjector(geometry, grid, lanes=3)
        settings = SIRT | {"backprojector": backprojector, "terms": 60, "tolerance_hu": 0}
        plain = sirt.sirt(projector, noisy, **(settings | {"solver": "plain"}))
        fast = sirt.sirt(projector, noisy, **settings)
        noise = (plain[1:] - plain[0]).std()
        assert np.sqrt(np.mean((fast - plain) ** 2)) < 0.005 * noise


def test_tolerance_holds_for_an_object_that_leaves_the_grid():
    """95 % of voxels are within 1 HU of plain SIRT, for a cylinder in the grid and one that crosses its sides.

    The second one needs more terms, and its image does not depend on the other one.
    """
    geometry = circular(views=40, columns=36, rows=8, **(SCANNER | dict(column_pitch_mm=16.0, row_pitch_mm=16.0)))
    small = Grid((6, 24, 24), (8.0, 11.0, 11.0))
    large = Grid((12, 36, 36), (8.0, 11.0, 11.0))
    whole = CpuProjector(geometry, large, 3)
    z, y, x = large.axes_mm()
    balls = (x / 100) ** 2 + (y[:, None] / 100) ** 2 + (z[:, None, None] / 20) ** 2 < 1
    rods = np.broadcast_to((x / 170) ** 2 + (y[:, None] / 150) ** 2 < 1, large.shape)
    clean = whole.forward(whole.pack_volume(np.stack([balls, rods, rods]).astype(np.float32) * np.float32(MU)))
    noise = np.random.default_rng(3).normal(0, 0.02, (2, geometry.views, geometry.rows, geometry.columns))
    noisy = (whole.unpack_projections(clean)[:2] + noise).astype(np.float32)
    counted = []

    def steps_of(tolerance_hu, lanes, solver="chebyshev"):
        counted.append(0)
        operator = CpuProjector(geometry, small, len(lanes))
        adjoint = operator.adjoint

        def count(projections, views, *rest, **settings):
            counted[-1] += views.start == 0
            return adjoint(projections, views, *rest, **settings)

        operator.adjoint = count
        settings = SIRT | {"tolerance_hu": tolerance_hu, "solver": solver}
        return sirt.sirt(operator, noisy[lanes], **settings, mu_water_per_mm=MU)

    both = [0, 1, 1]  # three lanes, for which other tests have compiled the kernels
    stopped, alone = steps_of(1, both), steps_of(1, [0])
    beyond = np.abs(stopped - steps_of(0, both, "plain")) / MU * 1000 > 1
    assert (beyond.mean(axis=(1, 2, 3)) < 0.06).all()
    assert counted[1] < counted[0] < SIRT["terms"]
    np.testing.assert_allclose(alone[0], stopped[0], atol=1e-4 * MU)


def test_chebyshev_coefficients_are_binomials():
    """K = 6 in integers: C(12, 6 - j) / 4^6, doubled for j > 0; the sum is 1."""
    expected = [special.comb(12, 6 - j, exact=True) / 4**6 * (1 if j == 0 else 2) for j in range(7)]
    np.testing.assert_allclose(sirt.chebyshev_coefficients(6, 6), expected, rtol=1e-12)
    assert sirt.chebyshev_coefficients(500, 500).sum() == pytest.approx(1)


def test_astra_parity_scales_a_helix_by_the_share_of_views():
    """Without normalization, a voxel on the axis is scaled by (turns that see it) / (all turns)."""
    geometry = helical(views=240, volume_height_mm=48, columns=72, rows=8, **SCANNER)
    line_integrals = project(geometry, finer=2)
    projector = CpuProjector(geometry, GRID)
    raw = fbp.fbp(projector, line_integrals, normalise="none")[0]
    turns = geometry.views / geometry.views_per_rotation
    middle = raw[4:8, 28:36, 28:36].mean() / MU
    assert middle == pytest.approx(1 / turns, rel=0.03)


def test_noise_is_uniform_along_a_helix(monkeypatch):
    """Noise SD of an end slice relative to the middle: under 1.5 with either pair.

    It would be much larger if rays that graze the grid contributed to the voxel-driven pair.
    """
    geometry = helical(
        views=150, volume_height_mm=48, columns=36, rows=6, **(SCANNER | dict(column_pitch_mm=16.0, row_pitch_mm=8.0))
    )
    grid = Grid((12, 32, 32), (4.0, 8.8, 8.8))
    noise = np.random.default_rng(8).normal(0, 0.01, (3, 150, 6, 36)).astype(np.float32)

    def ends_over_middle(backprojector):
        sd = sirt.sirt(CpuProjector(geometry, grid, 3), noise, **(SIRT | {"backprojector": backprojector})).std(0)
        return sd[1].mean() / sd[6].mean()

    assert ends_over_middle("adjoint") < 1.5
    assert ends_over_middle("voxel") < 1.5
    monkeypatch.setattr(sirt, "_shortest_mm", lambda grid, backprojector: 0.0)
    assert ends_over_middle("voxel") > 5


def test_fbp_returns_air_for_voxels_without_all_directions():
    """Six rows illuminate the middle of the volume, where the cylinder is correct; no other voxel is partly correct."""
    geometry = circular(views=120, columns=72, rows=6, **SCANNER)
    hu = (fbp.fbp(CpuProjector(geometry, GRID), project(geometry))[0] / MU - 1) * 1000
    z, y, x = GRID.axes_mm()
    zz, yy, xx = np.meshgrid(z, y, x, indexing="ij")
    # A ray to this height passes the detector's outermost row, half a row inside its edge, at the depth of the near
    # side.
    seen = np.abs(zz) < 2.5 * 8 * (500 - np.hypot(xx, yy)) / 1000
    core = np.hypot(xx, yy) < 20
    assert np.abs(hu[core & seen]).max() < 20 and (core & seen).sum() > 100
    assert np.all(hu[(np.hypot(xx, yy) < 100) & ~seen] == -1000)


def test_fbp_of_one_row_is_a_fan_beam():
    geometry = circular(views=120, columns=72, rows=1, **SCANNER)
    grid = Grid((1, 64, 64), (2.0, 4.4, 4.4))
    hu = (fbp.fbp(CpuProjector(geometry, grid), project(geometry, grid))[0, 0] / MU - 1) * 1000
    assert abs(hu[29:35, 29:35].mean()) < 3


def test_fbp_rejects_too_few_turns():
    """Half a turn plus the fan is needed: 180 + 2 x 16 degrees with this detector."""
    geometry = circular(views=100, turns=0.55, columns=72, rows=4, **SCANNER)
    with pytest.raises(InputError, match="at least 0.59 turns"):
        fbp.fbp(CpuProjector(geometry, GRID), np.ones((1, 100, 4, 72), np.float32))


def test_unseen_voxels_stay_at_air():
    """Two detector rows illuminate the middle slices only; the rest has no data and keeps zero attenuation."""
    geometry = circular(views=30, columns=72, rows=2, **SCANNER)
    projector = CpuProjector(geometry, GRID)
    image = sirt.sirt(projector, project(geometry, finer=1), **(SIRT | {"iterations": 20}))
    assert np.isfinite(image).all()
    assert np.all(image[0, 0] == 0) and image[0, 6, 32, 32] > MU / 2


@pytest.mark.parametrize(
    "call",
    [
        lambda p, b: sirt.sirt(p, b, **(SIRT | {"solver": "cg"})),
        lambda p, b: sirt.sirt(p, b, **(SIRT | {"iterations": 0})),
        lambda p, b: sirt.sirt(p, b, **(SIRT | {"terms": 0})),
        lambda p, b: sirt.sirt(p, b, **(SIRT | {"backprojector": "ray"})),
        lambda p, b: fbp.fbp(p, b, normalise="mean"),
    ],
)
def test_bad_arguments(call):
    geometry = circular(views=2, columns=4, rows=2, **SCANNER)
    with pytest.raises(InputError):
        call(CpuProjector(geometry, GRID), np.ones((1, 2, 2, 4), np.float32))
