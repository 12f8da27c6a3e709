"""SIRT and FDK on a water cylinder with inserts, and Chebyshev against plain SIRT."""

import numpy as np
import pytest
from scipy import special

from virtual_phantom import fbp, solvers
from virtual_phantom.errors import InputError
from virtual_phantom.geometry import Grid, circular, helical
from virtual_phantom.projectors.astra_cuda import AstraCudaProjector
from virtual_phantom.projectors.cpu import CpuProjector

MU = 0.02
SCANNER = dict(source_to_isocentre_mm=500.0, source_to_detector_mm=1000.0, column_pitch_mm=8.0, row_pitch_mm=8.0)
GRID = Grid((12, 64, 64), (4.0, 4.4, 4.4))
GEOMETRIES = {
    "circular": circular(views=120, columns=72, rows=16, **SCANNER),
    "helical": helical(views=160, volume_height_mm=48, columns=72, rows=12, **SCANNER),
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
def test_water_is_zero_and_inserts_are_right(scan, algorithm):
    """Water within 3 HU, inserts within 1 % of their attenuation, away from edges and from the end slices."""
    _, geometry, line_integrals = scan
    projector = CpuProjector(geometry, GRID)
    image = fbp.fbp(projector, line_integrals) if algorithm == "fdk" else solvers.sirt(projector, line_integrals)
    hu = (image[0] / MU - 1) * 1000
    _, y, x = GRID.axes_mm()
    water = x**2 + y[:, None] ** 2 < 98**2
    middle = slice(4, 8)
    for cx, cy, radius, value in inserts().values():
        distance = (x - cx) ** 2 + (y[:, None] - cy) ** 2
        water &= distance > (radius + 12) ** 2
        core = distance < (radius - 8) ** 2
        assert hu[middle][:, core].mean() == pytest.approx(value, abs=0.01 * (1000 + value))
    assert abs(hu[middle][:, water].mean()) < 3


@pytest.mark.parametrize("backprojector", ["adjoint", "voxel"])
def test_chebyshev_is_plain_sirt(backprojector):
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
        noisy = np.stack([clean, *(clean + random.normal(0, 0.02, clean.shape) for _ in range(3))]).astype(np.float32)
        projector = CpuProjector(geometry, grid, lanes=4)
        plain = solvers.sirt(projector, noisy, solver="plain", iterations=500, backprojector=backprojector)
        fast = solvers.sirt(projector, noisy, solver="chebyshev", iterations=500, terms=60, backprojector=backprojector)
        noise = (plain[1:] - plain[0]).std()
        assert np.sqrt(np.mean((fast - plain) ** 2)) < 0.005 * noise


def test_chebyshev_coefficients_are_binomials():
    """K = 6 by integers: C(12, 6 - j) / 4^6, doubled for j > 0; all of them sum to 1."""
    expected = [special.comb(12, 6 - j, exact=True) / 4**6 * (1 if j == 0 else 2) for j in range(7)]
    np.testing.assert_allclose(solvers.chebyshev_coefficients(6, 6), expected, rtol=1e-12)
    assert solvers.chebyshev_coefficients(500, 500).sum() == pytest.approx(1)


def test_astra_parity_scales_a_helix_by_the_share_of_views():
    """Without normalisation a voxel on the axis comes out scaled by (turns that see it) / (all turns)."""
    geometry = helical(views=240, volume_height_mm=48, columns=72, rows=8, **SCANNER)
    line_integrals = project(geometry, finer=2)
    projector = CpuProjector(geometry, GRID)
    raw = fbp.fbp(projector, line_integrals, normalise="none")[0]
    turns = geometry.views / geometry.views_per_rotation
    middle = raw[4:8, 28:36, 28:36].mean() / MU
    assert middle == pytest.approx(1 / turns, rel=0.03)


def test_adjoint_keeps_noise_even_along_a_helix():
    """Noise SD of an end slice over that of the middle: under 1.5 with the adjoint, over it with the voxel pair."""
    geometry = helical(
        views=150, volume_height_mm=48, columns=36, rows=6, **(SCANNER | dict(column_pitch_mm=16.0, row_pitch_mm=8.0))
    )
    grid = Grid((12, 32, 32), (4.0, 8.8, 8.8))
    noise = np.random.default_rng(8).normal(0, 0.01, (6, 150, 6, 36)).astype(np.float32)
    spread = {
        name: solvers.sirt(CpuProjector(geometry, grid, 6), noise, backprojector=name).std(0)
        for name in ("adjoint", "voxel")
    }
    ends = {name: sd[1].mean() / sd[6].mean() for name, sd in spread.items()}
    assert ends["adjoint"] < 1.5 < ends["voxel"]


def test_unseen_voxels_stay_at_air():
    """Two detector rows light up the middle slices only; the rest has no data and stays at zero attenuation."""
    geometry = circular(views=30, columns=72, rows=2, **SCANNER)
    projector = CpuProjector(geometry, GRID)
    image = solvers.sirt(projector, project(geometry, finer=1), iterations=20)
    assert np.isfinite(image).all()
    assert np.all(image[0, 0] == 0) and image[0, 6, 32, 32] > MU / 2


@pytest.mark.parametrize(
    "call",
    [
        lambda p, b: solvers.sirt(p, b, solver="cg"),
        lambda p, b: solvers.sirt(p, b, iterations=0),
        lambda p, b: solvers.sirt(p, b, terms=0),
        lambda p, b: solvers.sirt(p, b, backprojector="ray"),
        lambda p, b: fbp.fbp(p, b, normalise="mean"),
    ],
)
def test_bad_arguments(call):
    geometry = circular(views=2, columns=4, rows=2, **SCANNER)
    with pytest.raises(InputError):
        call(CpuProjector(geometry, GRID), np.ones((1, 2, 2, 4), np.float32))


def test_sirt_does_not_depend_on_the_layout_of_the_engine():
    """An engine that keeps lanes first and rows before views, as ASTRA does, gives the same image."""
    grid = Grid((4, 16, 16), (10.0, 16.0, 16.0))
    geometry = circular(views=20, columns=24, rows=4, **(SCANNER | dict(column_pitch_mm=24.0, row_pitch_mm=20.0)))
    scan = np.random.default_rng(4).random((2, 20, 4, 24)).astype(np.float32)
    expected = solvers.sirt(CpuProjector(geometry, grid, 2), scan, iterations=20, backprojector="voxel")

    class Engine:
        views_per_block = 20
        lanes = 2
        one_lane = staticmethod(AstraCudaProjector.one_lane)
        pack_projections = AstraCudaProjector.pack_projections
        unpack_volume = AstraCudaProjector.unpack_volume
        pack_volume = AstraCudaProjector.pack_volume
        empty_volume = AstraCudaProjector.empty_volume

        def __init__(self):
            self.geometry, self.grid, self.cpu = geometry, grid, CpuProjector(geometry, grid, 2)

        def forward(self, volume, views=slice(None)):
            projections = self.cpu.unpack_projections(self.cpu.forward(self.cpu.pack_volume(volume), views))
            return self.pack_projections(projections)

        def back(self, projections, views=slice(None), out=None):
            out += self.cpu.unpack_volume(
                self.cpu.back(self.cpu.pack_projections(np.swapaxes(projections, 1, 2)), views)
            )
            return out

    np.testing.assert_allclose(
        solvers.sirt(Engine(), scan, iterations=20, backprojector="voxel"), expected, rtol=1e-4, atol=1e-7
    )
