"""Point spread over the field by Zernike terms and by Gaussians, and the response within a pixel."""

import math

import galsim
import numpy as np
import pytest
from scipy.special import erf
from small_scenes import small_scenario

from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.optics.psf import FINE_PER_PX, pixel_psf, psf_table
from generator.optics.pupil import noll_degrees, wavefront_terms, zernike
from generator.scenario.lens.psf_spec import DiffractionSpec, FieldGaussianSpec, PixelSpec, PsfSpec, ZernikeSpec

PITCH_UM, F_NUMBER = 2.9, 8.0
LAM_OVER_DIAM_PX = 0.55 * F_NUMBER / PITCH_UM
# Measured on a fisheye of 180 deg: tangential sigma 0.54 px on the axis, 0.89 px at 75 deg.
WIDENING = {"radial_sigma_px": [[0, 0.54], [75, 0.55]], "tangential_sigma_px": [[0, 0.54], [75, 0.89]]}
WINGS = 0.22
"""Share of a star's light beyond 3.5 px in the same photographs."""


def widening() -> PsfSpec:
    return PsfSpec(field_gaussian=FieldGaussianSpec.model_validate(WIDENING), support_px=8)


def pixels(stamp, du=0.0, dv=0.0):
    """Pixels around a star at (du, dv) from a pixel's centre; multiples of 1/FINE_PER_PX."""
    first_u, first_v = (round((0.5 - offset) * FINE_PER_PX) for offset in (du, dv))
    side = stamp.shape[0] // FINE_PER_PX
    return stamp[first_v::FINE_PER_PX, first_u::FINE_PER_PX][:side, :side]


def moments(stamp):
    """First moments and the matrix of second ones of the fine stamp, px."""
    axis = (np.arange(len(stamp)) - len(stamp) // 2) / FINE_PER_PX
    light = stamp / stamp.sum()
    first = np.array([(light * axis).sum(), (light * axis[:, None]).sum()])
    u, v = axis - first[0], axis[:, None] - first[1]
    mixed = (light * u * v).sum()
    return first, np.array([[(light * u * u).sum(), mixed], [mixed, (light * v * v).sum()]])


def test_noll_s_table() -> None:
    """Degrees and orders of the first polynomials as Noll 1976 lists them, and all orthonormal up to 37."""
    table = {1: (0, 0), 2: (1, 1), 3: (1, -1), 4: (2, 0), 5: (2, -2), 6: (2, 2), 7: (3, -1), 8: (3, 1), 9: (3, -3),
             10: (3, 3), 11: (4, 0), 12: (4, 2), 13: (4, -2), 14: (4, 4), 15: (4, -4), 16: (5, 1), 22: (6, 0)}  # fmt: skip
    assert {number: noll_degrees(number) for number in table} == table
    # Gauss's nodes in rho^2 and even steps around are exact for the products of these polynomials.
    nodes, weights = np.polynomial.legendre.leggauss(20)
    rho, theta = np.meshgrid(np.sqrt((nodes + 1) / 2), np.arange(40) * 2 * np.pi / 40)
    basis = np.array([zernike(number, rho, theta) for number in range(1, 38)])
    inner = np.einsum("itr,jtr,r->ij", basis, basis, weights / 2) / 40
    np.testing.assert_allclose(inner, np.eye(37), atol=1e-12)


def test_zernike_terms_against_galsim() -> None:
    """A mixture of terms 4 to 15, polynomials of the field, at a place off both axes: within 1 % of GalSim's peak."""
    rng = np.random.default_rng(3)
    field = complex(0.6, -0.5)
    numbers, powers = range(4, 16), rng.integers(0, 3, (12, 2))
    wanted = rng.normal(0, 0.05, 12)
    terms = tuple(
        ZernikeSpec(noll=number, waves=value / (0.6**u * (-0.5) ** v), u_power=int(u), v_power=int(v))
        for number, value, (u, v) in zip(numbers, wanted, powers, strict=True)
    )
    psf = PsfSpec(diffraction=DiffractionSpec(f_number=F_NUMBER, zernike=terms), support_px=18)
    profile = galsim.OpticalPSF(
        lam_over_diam=LAM_OVER_DIAM_PX, aberrations=[0.0, 0.0, 0.0, 0.0, *wanted], oversampling=2, pad_factor=3
    )
    theirs = profile.drawImage(nx=37, ny=37, scale=1.0, dtype=float).array
    ours = pixels(pixel_psf(psf, 550.0, field, PITCH_UM))
    assert np.abs(ours - theirs).max() < 0.01 * theirs.max()


def test_coma_and_astigmatism_of_the_simple_keys_are_zernike_terms() -> None:
    simple = DiffractionSpec(f_number=F_NUMBER, coma_waves=0.3, astigmatism_waves=0.2)
    written = DiffractionSpec(
        f_number=F_NUMBER,
        zernike=(
            ZernikeSpec(noll=8, waves=0.3, u_power=1), ZernikeSpec(noll=7, waves=0.3, v_power=1),
            ZernikeSpec(noll=6, waves=0.2, u_power=2), ZernikeSpec(noll=6, waves=-0.2, v_power=2),
            ZernikeSpec(noll=5, waves=0.4, u_power=1, v_power=1),
        ),
    )  # fmt: skip
    field = complex(0.4, -0.7)
    ours, theirs = wavefront_terms(simple, field), wavefront_terms(written, field)
    assert set(ours) == set(theirs) == {5, 6, 7, 8}
    assert all(ours[number] == pytest.approx(theirs[number], rel=1e-12) for number in ours)


def test_a_displaced_node_of_coma() -> None:
    """Coma 0.3 (H - a), a = (0.4, 0.1), as of a tilted element: none at the node, opposite on both sides of it."""
    node = complex(0.4, 0.1)
    terms = (
        ZernikeSpec(noll=8, waves=0.3, u_power=1), ZernikeSpec(noll=8, waves=-0.3 * node.real),
        ZernikeSpec(noll=7, waves=0.3, v_power=1), ZernikeSpec(noll=7, waves=-0.3 * node.imag),
    )  # fmt: skip
    psf = PsfSpec(diffraction=DiffractionSpec(f_number=F_NUMBER, zernike=terms), support_px=16)
    at_node, before, behind = (
        moments(pixel_psf(psf, 550.0, node + step, PITCH_UM))[0] for step in (0, -0.3 - 0.2j, 0.3 + 0.2j)
    )
    assert np.abs(at_node).max() < 1e-3
    np.testing.assert_allclose(before, -behind, atol=1e-3)
    assert np.hypot(*behind) > 0.2
    # Along the line from the node, inwards or outwards by the coefficient's sign.
    assert abs(behind[0] * 0.2 - behind[1] * 0.3) < 0.02 * np.hypot(*behind)


@pytest.mark.parametrize(
    ("angle", "radial", "tangential", "share"), [(0.0, 0.54, 0.54, 0.32), (75.0, 0.55, 0.89, 0.21)]
)
def test_a_widening_gaussian(angle, radial, tangential, share) -> None:
    """Second moments along and across the field's radius: sigma^2 + 1/12, within 0.5 %; share of the nearest pixel.

    The share is the measured one, 0.32 and 0.21, once the wings' light is taken off: within 0.01.
    """
    outward = np.exp(1j * 0.7)
    stamp = pixel_psf(widening(), 550.0, outward, None, angle)
    _, matrix = moments(stamp)
    along, across = np.array([outward.real, outward.imag]), np.array([-outward.imag, outward.real])
    assert along @ matrix @ along == pytest.approx(radial**2 + 1 / 12, rel=5e-3)
    assert across @ matrix @ across == pytest.approx(tangential**2 + 1 / 12, rel=5e-3)
    nearest = pixels(pixel_psf(widening(), 550.0, 1 + 0j, None, angle)).max()
    by_hand = erf(0.5 / math.sqrt(2) / radial) * erf(0.5 / math.sqrt(2) / tangential)
    assert nearest == pytest.approx(by_hand, rel=1e-3)
    assert (1 - WINGS) * nearest == pytest.approx(share, abs=0.01)


def test_stars_of_a_fisheye_widen_off_axis() -> None:
    """In a rendered frame: second moments across the radius by the angle off axis, within 10 %, their mean within 2 %.

    A star takes the nearest of 17 x 17 nodes, which is up to half their distance away: 3 % of the width here.
    """
    scenario = small_scenario(
        camera__width=520, camera__height=520, camera__model="equidistant", camera__hfov_deg=None, camera__f_px=165.0,
        camera__psf={"field_gaussian": WIDENING, "support_px": 8}, sky__bortle=None, time__exposure_s=1.0,
        stars={"limiting_magnitude": 4.2}, atmosphere__extinction=False,
    )  # fmt: skip
    plan = plan_frame(scenario, 0)
    expected = render_expected(plan)
    assert psf_table(plan.spec.camera).stamps.shape[:3] == (1, 17, 17)
    offset = np.arange(-9, 10)
    ratios, far = [], 0
    place = np.stack([expected.u_px, expected.v_px], axis=1)
    for row, (u, v) in enumerate(place):
        column, line = round(u), round(v)
        near = np.abs(np.delete(place, row, axis=0) - (u, v)).max(axis=1).min()
        if not (9 <= column < 511 and 9 <= line < 511) or near < 19 or expected.star_electrons[row] < 1000:
            continue
        window = expected.electrons[line - 9 : line + 10, column - 9 : column + 10].astype(float)
        away = np.array([u, v]) - 259.5
        angle = math.degrees(np.hypot(*away) / 165.0)
        du, dv = np.meshgrid(offset + column - u, offset + line - v)
        across = (dv * away[0] - du * away[1]) / np.hypot(*away)
        found = (window * across**2).sum() / window.sum()
        sigma = np.interp(angle, [0, 75], [0.54, 0.89])
        ratios.append(found / (sigma**2 + 1 / 12))
        far += angle > 60
    assert far >= 5
    np.testing.assert_allclose(ratios, 1, atol=0.1)
    assert np.mean(ratios) == pytest.approx(1, abs=0.02)


def test_response_within_a_pixel() -> None:
    """Sensitive part 0.6 x 0.8: electrons by the star's place in a pixel as the error function has them, mean 1."""
    psf = PsfSpec(gaussian_sigma_px=0.35, pixel=PixelSpec(sensitive_width=0.6, sensitive_height=0.8), support_px=6)
    stamp = pixel_psf(psf, 550.0, 0j, None)

    def by_hand(offset: float, width: float) -> float:
        edges = [np.arange(-8, 9) - offset + side * width / 2 for side in (1, -1)]
        return float((erf(edges[0] / math.sqrt(2) / 0.35) - erf(edges[1] / math.sqrt(2) / 0.35)).sum() / 2 / width)

    totals = {}
    for du, dv in ((0.0, 0.0), (0.5, 0.0), (0.25, 0.5), (-0.375, 0.125)):
        totals[du, dv] = pixels(stamp, du, dv).sum()
        assert totals[du, dv] == pytest.approx(by_hand(du, 0.6) * by_hand(dv, 0.8), rel=2e-3)
    assert totals[0.0, 0.0] > 1.1 > 0.95 > totals[0.5, 0.0]
    phases = [pixels(stamp, a / 8, b / 8).sum() for a in range(-4, 4) for b in range(-4, 4)]
    assert np.mean(phases) == pytest.approx(1, abs=1e-3)


def test_diffusion_is_a_further_gaussian() -> None:
    blurred = PsfSpec(gaussian_sigma_px=0.4, pixel=PixelSpec(diffusion_sigma_px=0.3), support_px=6)
    wider = PsfSpec(gaussian_sigma_px=0.5, support_px=6)
    np.testing.assert_allclose(pixel_psf(blurred, 550.0, 0j, None), pixel_psf(wider, 550.0, 0j, None), atol=1e-9)


@pytest.mark.parametrize(
    ("psf", "message"),
    [
        ({"field_gaussian": WIDENING | {"radial_sigma_px": [[20, 1], [10, 2]]}}, "increasing"),
        ({"field_gaussian": {"radial_sigma_px": [[0, 1]]}}, "tangential_sigma_px"),
        ({"diffraction": {"f_number": 2.8, "zernike": [{"noll": 3, "waves": 0.1}]}}, "noll"),
        ({"gaussian_sigma_px": 1.0, "pixel": {"sensitive_width": 0}}, "sensitive_width"),
    ],
)
def test_refused(psf, message) -> None:
    with pytest.raises(ScenarioError, match=message):
        small_scenario(camera__psf=psf, camera__pixel_pitch_um=2.9)
