"""Point spread functions against GalSim, flux, field dependence, and a user's stack."""

import gzip
import re

import galsim
import numpy as np
import OpenEXR
import pytest
from astropy.io import fits
from small_scenes import BASE, small_scenario

from generator import plugins
from generator.errors import ScenarioError
from generator.frame.exposure.expected import render_expected
from generator.frame.plan import plan_frame
from generator.optics.psf import FINE_PER_PX, pixel_psf, psf_table
from generator.scenario.camera_spec import CameraSpec
from generator.scenario.file import parse_scenario
from generator.scenario.lens.psf_spec import DiffractionSpec, MoffatSpec, PsfSpec

PITCH_UM = 2.9
F_NUMBER = 2.8
LAM_OVER_DIAM_PX = 0.55 * F_NUMBER / PITCH_UM
AIRY = {"diffraction": DiffractionSpec(f_number=F_NUMBER)}
CASES = {
    "gaussian": (PsfSpec(gaussian_sigma_px=1.3), galsim.Gaussian(sigma=1.3)),
    "moffat": (PsfSpec(moffat=MoffatSpec(fwhm_px=2.5, beta=3.5), support_px=20), galsim.Moffat(beta=3.5, fwhm=2.5)),
    "airy": (PsfSpec(**AIRY, support_px=24), galsim.Airy(lam_over_diam=LAM_OVER_DIAM_PX)),
    "disk": (PsfSpec(defocus_disk_px=5.0, gaussian_sigma_px=0.4),
             galsim.Convolve(galsim.TopHat(2.5), galsim.Gaussian(sigma=0.4))),
}  # fmt: skip


def sampled(stamp: np.ndarray, du: float, dv: float) -> np.ndarray:
    """Pixels around a star at (du, dv) from a pixel's centre; multiples of 1/FINE_PER_PX."""
    first_u, first_v = (round((0.5 - offset) * FINE_PER_PX) for offset in (du, dv))
    return stamp[first_v::FINE_PER_PX, first_u::FINE_PER_PX]


def by_galsim(profile, size: int, du: float, dv: float) -> np.ndarray:
    image = profile.drawImage(nx=size, ny=size, scale=1.0, offset=(du, dv), method="auto", dtype=float)
    return image.array


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.25, -0.375), (0.5, 0.125)])
@pytest.mark.parametrize("case", sorted(CASES))
def test_pixel_images_against_galsim(case, offset) -> None:
    """Within 1 % of the peak in every pixel of the support."""
    psf, profile = CASES[case]
    stamp = pixel_psf(psf, 550.0, 0j, PITCH_UM)
    ours = sampled(stamp, *offset)
    side = 2 * psf.support_px + 1
    theirs = by_galsim(profile, side, *offset)
    ours = ours[:side, :side]
    assert np.abs(ours - theirs).max() < 0.01 * theirs.max()


@pytest.mark.parametrize(("fwhm_px", "beta", "support_px"), [(3.0, 1.5, 10), (2.0, 2.0, 8)])
def test_wide_wings_of_moffat_are_those_of_its_formula(fwhm_px, beta, support_px) -> None:
    """Light within r: 1 - (1 + r^2 / a^2)^(1 - beta), a = fwhm / (2 sqrt(2^(1 / beta) - 1)) (Moffat 1969)."""
    stamp = sampled(
        pixel_psf(
            PsfSpec(moffat=MoffatSpec(fwhm_px=fwhm_px, beta=beta), support_px=support_px), 550.0, 0j, PITCH_UM
        ), 0.0, 0.0,
    )  # fmt: skip
    a = fwhm_px / (2 * np.sqrt(2 ** (1 / beta) - 1))
    side = support_px + 0.5
    # The light of the square: for each angle from the middle of an edge, that within the circle through the edge.
    angle = np.linspace(0, np.pi / 4, 4001)
    within = 1 - (1 + (side / np.cos(angle) / a) ** 2) ** (1 - beta)
    square = float(np.trapezoid(within, angle) / (np.pi / 4))
    assert stamp[: 2 * support_px + 1, : 2 * support_px + 1].sum() == pytest.approx(square, abs=1e-3)


@pytest.mark.parametrize("case", sorted(CASES))
def test_encircled_energy_and_moments_against_galsim(case) -> None:
    """Light in squares of growing size, and the second moment inside 13 x 13 px, within 1 %."""
    psf, profile = CASES[case]
    side = 2 * psf.support_px + 1
    ours = sampled(pixel_psf(psf, 550.0, 0j, PITCH_UM), 0.0, 0.0)[:side, :side]
    theirs = by_galsim(profile, side, 0.0, 0.0)
    middle = psf.support_px
    for half in (0, 1, 2, 3, 5, 8, middle):
        inner = slice(middle - half, middle + half + 1)
        assert ours[inner, inner].sum() == pytest.approx(theirs[inner, inner].sum(), rel=0.01)
    inner = slice(middle - 6, middle + 7)
    square = np.arange(-6, 7) ** 2

    def moment(image) -> float:
        return float((image[inner, inner] * (square + square[:, None])).sum() / image[inner, inner].sum())

    assert moment(ours) == pytest.approx(moment(theirs), rel=0.01)


@pytest.mark.parametrize(("waves", "names"), [
    ({"defocus_waves": 0.15}, {"defocus": 0.15}),
    ({"coma_waves": 0.15}, {"coma2": 0.15}),
    ({"astigmatism_waves": 0.15}, {"astig2": 0.15}),
])  # fmt: skip
def test_aberrations_against_galsim(waves, names) -> None:
    """Noll's Zernike polynomials at the corner along +u: GalSim's OpticalPSF, within 1 % of the peak."""
    psf = PsfSpec(diffraction=DiffractionSpec(f_number=F_NUMBER * 3, **waves), support_px=20)
    aberrations = {"defocus": 0.0, "coma2": 0.0, "astig2": 0.0} | names
    # Along +u the coma is Z8 (cosine), which GalSim calls coma1's partner coma2, and the astigmatism Z6, its astig2.
    profile = galsim.OpticalPSF(
        lam_over_diam=3 * LAM_OVER_DIAM_PX, defocus=aberrations["defocus"], astig2=aberrations["astig2"],
        coma2=aberrations["coma2"], oversampling=2, pad_factor=3,
    )  # fmt: skip
    ours = sampled(pixel_psf(psf, 550.0, 1 + 0j, PITCH_UM), 0.0, 0.0)[:41, :41]
    theirs = by_galsim(profile, 41, 0.0, 0.0)
    assert np.abs(ours - theirs).max() < 0.01 * theirs.max()


def test_coma_points_along_the_field_s_radius_and_grows() -> None:
    """Centroid and third moment turn with the field's direction; on the axis nothing is left."""
    psf = PsfSpec(diffraction=DiffractionSpec(f_number=8.0, coma_waves=0.3), support_px=20)
    axis = (np.arange(41 * FINE_PER_PX + 1) - 41 * FINE_PER_PX / 2) / FINE_PER_PX

    def skew(field):
        stamp = pixel_psf(psf, 550.0, field, PITCH_UM)
        return complex((stamp * axis).sum(), (stamp * axis[:, None]).sum()) / stamp.sum()

    along = skew(1 + 0j)
    assert abs(along) > 0.3
    assert abs(along.imag) < 1e-3
    turned = skew(np.exp(1j * np.radians(50)))
    assert np.angle(turned / along) == pytest.approx(np.radians(50), abs=0.01)
    assert abs(skew(0j)) < 1e-6
    assert abs(skew(0.5 + 0j)) < 0.75 * abs(along)


FIELD = {
    "camera__psf": {
        "diffraction": {"f_number": 2.8, "coma_waves": 0.2, "astigmatism_waves": 0.1},
        "gaussian_sigma_px": 0.5,
        "lateral_chromatic_px": 1.5,
    },
    "camera__pixel_pitch_um": 2.9,
    "camera__width": 540,
    "camera__height": 360,
    "sky": None,
    "stars": {"limiting_magnitude": 3.0},
}


def test_flux_is_conserved_inside_the_support() -> None:
    """All light of stars well inside the frame, but for what the table itself leaves outside: within 0.1 %."""
    plan = plan_frame(small_scenario(**FIELD), 0)
    frame = render_expected(plan)
    inside = (frame.u_px > 20) & (frame.u_px < 520) & (frame.v_px > 20) & (frame.v_px < 340)
    assert inside.sum() > 20
    wanted = (frame.star_electrons * frame.fraction_in_frame).sum()
    assert float(frame.electrons.astype(float).sum()) == pytest.approx(wanted, rel=1e-3)
    assert frame.fraction_in_frame[inside].min() > 0.98
    assert psf_table(plan.spec.camera).stamps.shape[:3] == (4, 9, 9)


def test_every_phase_of_the_table_carries_the_same_light() -> None:
    """Sums over whole pixels at all 64 fine offsets agree within 0.1 %."""
    for psf, _ in CASES.values():
        stamp = pixel_psf(psf, 550.0, 0j, PITCH_UM)[:-1, :-1]
        sums = stamp.reshape(stamp.shape[0] // FINE_PER_PX, FINE_PER_PX, -1, FINE_PER_PX).sum(axis=(0, 2))
        np.testing.assert_allclose(sums, sums.mean(), rtol=1e-3)


def test_tabulated_gaussian_draws_what_the_analytic_one_draws() -> None:
    """The same stars by the table and by the error function: within 0.5 % of each star's peak."""
    base = {"camera__width": 540, "camera__height": 360, "sky": None, "stars": {"limiting_magnitude": 3.0}}
    table = render_expected(plan_frame(small_scenario(**base, camera__psf={"gaussian_sigma_px": 0.8}), 0))
    exact = render_expected(plan_frame(small_scenario(**base, camera__psf_sigma_px=0.8), 0))
    scale = exact.electrons.max()
    assert np.abs(table.electrons - exact.electrons).max() < 0.01 * scale
    bright = exact.electrons > 0.05 * scale
    np.testing.assert_allclose(table.electrons[bright], exact.electrons[bright], rtol=0.01)


def test_lateral_colour_moves_red_outwards() -> None:
    """A blue and a red sensor see the same star 1.5 px x distance / corner x 200 nm apart, to the spectra's means."""
    frames = {}
    for name in ("blue", "red"):
        scenario = small_scenario(**FIELD | {"camera__psf": {"gaussian_sigma_px": 0.8, "lateral_chromatic_px": 3.0}},
                                  sensor__quantum_efficiency=f"cmos-{name}")  # fmt: skip
        frames[name] = render_expected(plan_frame(scenario, 0))
    blue, red = frames["blue"], frames["red"]
    corner = np.hypot(270, 180)
    shifts = []
    for row in np.argsort(-blue.star_electrons)[:40]:
        u, v = blue.u_px[row], blue.v_px[row]
        if not (15 < u < 525 and 15 < v < 345) or np.hypot(u - 269.5, v - 179.5) < 80:
            continue
        close = np.hypot(blue.u_px - u, blue.v_px - v) < 25
        if close.sum() > 1:
            continue
        centres = []
        for frame in (blue, red):
            window = np.s_[round(v) - 10 : round(v) + 11, round(u) - 10 : round(u) + 11]
            rows, columns = np.mgrid[window]
            light = frame.electrons[window].astype(float)
            centres.append(complex((light * columns).sum(), (light * rows).sum()) / light.sum())
        outward = complex(u - 269.5, v - 179.5)
        shifts.append((centres[1] - centres[0]) / outward * corner)
    shifts = np.array(shifts)
    assert len(shifts) > 5
    assert np.abs(shifts.imag).max() < 0.02
    # Effective wavelengths of the two filters lie about 160 nm apart; bands are 162.5 nm wide.
    assert shifts.real.mean() == pytest.approx(3.0 * 160 / 200, rel=0.25)


def write_stack(path, sides=(33, 33), count=3) -> None:
    axis = np.arange(sides[1]) - sides[1] // 2
    images = {
        f"psf{n}": np.exp(-(axis**2 + (np.arange(sides[0])[:, None] - sides[0] // 2) ** 2) / 2 / (4 + n) ** 2).astype(
            np.float32
        )
        for n in range(count)
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, images) as file:
        file.write(str(path))


def stack_scenario(folder, name, **stack):
    import yaml

    tree = BASE | {"camera": BASE["camera"] | {"psf": {"stack": {"file": name, "oversampling": 4} | stack}}}
    return parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml"))


@pytest.mark.parametrize("kind", ["exr", "fits"])
def test_a_user_s_stack_is_used(tmp_path, kind) -> None:
    """Gaussians of sigma 1 px on the axis and 1.5 px at the corner, four samples per pixel, come out as such."""
    if kind == "exr":
        write_stack(tmp_path / "psf.exr", (65, 65))
    else:
        axis = np.arange(65) - 32
        square = axis**2 + axis[:, None] ** 2
        fits.writeto(tmp_path / "psf.fits", np.array([np.exp(-square / 2 / (4 + n) ** 2) for n in range(3)]))
    camera: CameraSpec = stack_scenario(tmp_path, f"psf.{kind}").frame(0).camera
    assert camera.psf is not None
    for field, sigma in ((0j, 1.0), (1 + 0j, 1.5), (0.5j, 1.25)):
        ours = sampled(pixel_psf(camera.psf, 550.0, field, None), 0.0, 0.0)[:25, :25]
        theirs = by_galsim(galsim.Gaussian(sigma=sigma), 25, 0.0, 0.0)
        assert np.abs(ours - theirs).max() < 0.01 * theirs.max()


def test_bad_stacks_are_refused(tmp_path) -> None:
    write_stack(tmp_path / "even.exr", (32, 32))
    write_stack(tmp_path / "oblong.exr", (33, 31))
    (tmp_path / "text.exr").write_text("not an image")
    for name, fragment in (("even.exr", "odd side"), ("oblong.exr", "expected (n, side, side)"),
                           ("text.exr", "cannot be read"), ("none.exr", "cannot be read"),
                           ("../secret.exr", "leaves the scenario's folder")):  # fmt: skip
        with pytest.raises(ScenarioError) as caught:
            stack_scenario(tmp_path, name)
        assert "camera.psf.stack" in str(caught.value)
        assert fragment in str(caught.value)


def test_stacks_are_judged_by_their_headers(tmp_path) -> None:
    """A gzip file by the name of a FITS file is not unpacked; a header that claims terabytes is not believed."""
    claims = fits.Header([("SIMPLE", True), ("BITPIX", -64), ("NAXIS", 3), *((f"NAXIS{n}", 99999) for n in (1, 2, 3))])
    (tmp_path / "claims.fits").write_bytes(claims.tostring(padding=True).encode())
    with gzip.open(tmp_path / "packed.fits", "wb") as file:
        file.write(claims.tostring(padding=True).encode() + bytes(2880))
    write_stack(tmp_path / "large.exr", (4001, 4001))
    for name, fragment in (("claims.fits", "found shape (99999, 99999, 99999)"),
                           ("packed.fits", "compressed files are not read"),
                           ("large.exr", "found a side of 4001 samples, expected 3 to 480")):  # fmt: skip
        with pytest.raises(ScenarioError, match=re.escape(fragment)):
            stack_scenario(tmp_path, name)


def test_table_has_the_same_bits_again() -> None:
    plugins.start()
    plan = plan_frame(small_scenario(**FIELD), 0)
    np.testing.assert_array_equal(render_expected(plan).electrons, render_expected(plan).electrons)
