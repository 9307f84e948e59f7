"""What `celnav calibrate` reads: FITS images within bounds, RMS' centroids and platepars; and its refusals."""

from __future__ import annotations

import bz2
import gzip
import json

import numpy as np
import pytest
from astropy.io import fits
from calibration_sky import LAT_DEG, LON_DEG, apparent_stars, frame_of, perspective_positions

import celnav
from celnav.__main__ import main
from celnav.calibrating.calibrate import calibrate
from celnav.command.calibrating import _mask_picture
from celnav.command.calibration_frames import read_frames, read_rms_centroids
from celnav.command.pointing import Pointing
from celnav.errors import CalibrationError, ImageError, TimeError
from celnav.reading import fits_file
from celnav.reading.fits_file import read_fits
from celnav.sky.fits_times import block_middle

PIXELS = np.arange(600, dtype=np.uint16).reshape(20, 30) + 40000
DATE = "2018-08-06T05:17:04.752"


def written(path, pack=lambda data: data, **header):
    unit = fits.PrimaryHDU(PIXELS, fits.Header(header))
    plain = path.with_suffix(".plain")
    unit.writeto(plain, overwrite=True)
    path.write_bytes(pack(plain.read_bytes()))
    return path


@pytest.mark.parametrize("pack", [lambda data: data, gzip.compress, bz2.compress])
def test_fits_is_read_plain_and_compressed(tmp_path, pack):
    path = written(tmp_path / "frame.fits", pack, **{"DATE-OBS": DATE, "EXPTIME": 60.0})
    image = celnav.read_image(path)
    assert image.dtype == np.uint16
    assert (image == PIXELS).all()
    found = read_fits(path)
    assert found.exposure.middle.isoformat() == "2018-08-06T05:17:34.752000+00:00"
    assert found.exposure.length_s == 60.0


def test_fits_times_of_the_standard(tmp_path):
    average = written(tmp_path / "a.fits", **{"DATE-AVG": "2018-08-06T05:18:00", "DATE-OBS": DATE, "EXPTIME": 60.0})
    assert read_fits(average).exposure.middle.minute == 18
    ends = written(tmp_path / "b.fits", **{"DATE-BEG": "2018-08-06T05:00:00", "DATE-END": "2018-08-06T05:02:00"})
    assert read_fits(ends).exposure.middle.minute == 1
    for header in (
        {},
        {"DATE-OBS": "2018-08-06", "EXPTIME": 1.0},
        {"DATE-OBS": DATE},
        {"DATE-OBS": DATE, "EXPTIME": -1.0},
    ):
        assert read_fits(written(tmp_path / "c.fits", **header)).exposure.middle is None


def test_block_of_a_meteor_station_gives_its_mean_and_its_time(tmp_path):
    first = fits.PrimaryHDU()
    first.header["NFRAMES"], first.header["FPS"] = 256, 25.0
    units = [first, *(fits.ImageHDU(PIXELS + i, name=name) for i, name in enumerate(("MAXPIXEL", "AVEPIXEL")))]
    path = tmp_path / "FF_XX0001_20230421_212224_982_0115712.fits"
    fits.HDUList(units).writeto(path)
    found = read_fits(path)
    assert (found.pixels == PIXELS + 1).all()
    assert found.exposure.middle.isoformat() == "2023-04-21T21:22:30.102000+00:00"
    assert block_middle("FF_XX0001_20231399_212224_982_0.fits", 10.0) is None


@pytest.mark.parametrize("pack", [lambda data: data, gzip.compress, bz2.compress])
def test_fits_that_is_cut_is_refused(tmp_path, pack):
    path = written(tmp_path / "frame.fits", pack)
    path.write_bytes(path.read_bytes()[:-40] if pack is not gzip.compress else path.read_bytes()[:-20])
    whole = pack(b"x") == b"x"
    if whole:
        path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ImageError, match=r"frame\.fits"):
        read_fits(path)


def test_bombs_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(fits_file, "MAX_BYTES", 3_000_000)
    for pack in (gzip.compress, bz2.compress):
        path = tmp_path / "bomb.fits"
        path.write_bytes(pack(b"SIMPLE" + bytes(50_000_000)))
        with pytest.raises(ImageError, match="larger than 3 MB"):
            read_fits(path)
    monkeypatch.setattr(fits_file, "MAX_PIXELS", 100)
    with pytest.raises(ImageError, match="600 pixels"):
        read_fits(written(tmp_path / "large.fits"))


def test_fits_without_a_picture_is_refused(tmp_path):
    path = tmp_path / "cube.fits"
    fits.PrimaryHDU(np.zeros((2, 3, 4))).writeto(path)
    with pytest.raises(ImageError, match="no image of two axes"):
        read_fits(path)
    path.write_bytes(gzip.compress(b"text"))
    with pytest.raises(ImageError, match="not a FITS file"):
        read_fits(path)


def rms_night(sigma_px=0.1):
    """A night of a meteor camera in RMS' format: five frames of named centroids; and the camera's attitude."""
    R_cam = Pointing(237.0, 41.0, -3.0).R_cam
    lens = (890.0, 630.0, 362.0, -0.30, 0.10, 0.0006, -0.0004)
    night = {}
    for number in range(5):
        utc = f"2022-09-14T2{number // 3}:{10 + 20 * (number % 3)}:05.120000+00:00"
        enu, v_mag = apparent_stars(utc, 6.0, 51.88, -1.3)
        uv = perspective_positions(enu, R_cam, lens)
        rng = np.random.default_rng(number)
        frame, _ = frame_of(
            utc, uv, v_mag, (1280, 720), rng, sigma_px=sigma_px, false=3, visible=(R_cam @ enu.T)[2] > 0.5
        )
        found = frame.detections
        rows = [
            [2459837.3, float(v), float(u), float(1e5 * flux), 0.0, 0.0, 5.0]
            for (u, v), flux in zip(found.uv, found.flux, strict=True)
        ]
        stamp = utc[:10].replace("-", "") + "_" + utc[11:17].replace(":", "") + "00_000"
        name = f"FF_XX0001_{stamp}_0{number}.fits"
        night[name] = {"auto_recalibrated": True, "X_res": 1280, "Y_res": 720, "F_scale": 15.6, "star_list": rows}
    night["FF_XX0001_20220914_230000_000_0.fits"] = {"auto_recalibrated": False, "star_list": []}
    return night, R_cam


@pytest.mark.journey
def test_centroids_of_rms_calibrate_their_camera(tmp_path, capsys):
    night, _ = rms_night()
    path = tmp_path / "platepars_all_recalibrated.json"
    path.write_text(json.dumps(night))
    frames = read_rms_centroids(path)
    assert len(frames) == 5
    out = tmp_path / "camera.json"
    place = ["--lat", "51.88", "--lon", "-1.3"]
    given, kept = tmp_path / "given.png", tmp_path / "kept.png"
    mask = np.zeros((720, 1280), dtype=bool)
    mask[700:] = True
    given.write_bytes(_mask_picture(mask))
    masks = ["--mask", str(given), "--mask-out", str(kept)]
    assert main(["calibrate", str(path), *place, *masks, "--models", "brown_conrady", "--out", str(out)]) == 0
    assert ((celnav.read_image(kept) > 0) == mask).all()
    assert "decentring" in capsys.readouterr().out
    content = json.loads(out.read_text())
    # The stamps mark the start of 10.24 s; a turn of the sky by a wrong half would be 77 arcsec.
    assert content["calibration"]["plain_rms_px"] == pytest.approx(0.1, rel=0.1)
    assert content["calibration"]["one_attitude_per"] == "night"
    assert celnav.read_camera_file(out).camera.f_px == pytest.approx(890, abs=0.5)


def test_a_mask_that_cannot_be_learnt_is_named(tmp_path, capsys):
    """Three of the same image are too few; and a folder that is missing is known before anything is read."""
    path = str(written(tmp_path / "frame.fits", **{"DATE-OBS": DATE, "EXPTIME": 60.0}))
    place = ["--lat", "0", "--lon", "0", "--out", str(tmp_path / "camera.json")]
    assert main(["calibrate", path, path, path, *place, "--mask-out", str(tmp_path / "mask.png")]) == 2
    assert "a mask is learnt from 5 images" in capsys.readouterr().err
    assert main(["calibrate", path, *place, "--mask-out", str(tmp_path / "none" / "mask.png")]) == 2
    assert "--mask-out" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.png"))


def test_platepar_is_a_guess(tmp_path):
    path = tmp_path / "platepar_cmn2010.cal"
    path.write_text(json.dumps({"F_scale": 15.6, "X_res": 1280, "Y_res": 720}))
    found = celnav.read_camera_file(path)
    assert found.camera.f_px == pytest.approx(15.6 * 180 / np.pi)
    assert "scale alone" in found.assumed[0]
    night, _ = rms_night()
    centroids = tmp_path / "centroids.json"
    centroids.write_text(json.dumps(dict(list(night.items())[:1])))
    frames = read_rms_centroids(centroids)
    fitted = calibrate(
        frames, 51.88, -1.3, camera=found.camera, form=celnav.LensForm("brown_conrady", 2, decentring=True)
    )
    assert fitted.rms_px == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", "must hold platepars"),
        ("{", "not JSON"),
        ("{}", "no recalibrated frame"),
        (json.dumps({"a": {"auto_recalibrated": True, "star_list": [[1]] * 30}}), "X_res"),
        (
            json.dumps({"a": {"auto_recalibrated": True, "X_res": 10, "Y_res": 10, "star_list": [[1], "x"] * 30}}),
            "star_list must be rows",
        ),
    ],
)
def test_damaged_centroids_are_refused(tmp_path, content, message):
    path = tmp_path / "stars.json"
    path.write_text(content)
    with pytest.raises(CalibrationError, match=message):
        read_rms_centroids(path)


def test_times_must_be_known(tmp_path, capsys):
    path = str(written(tmp_path / "frame.fits"))
    with pytest.raises(TimeError, match="DATE-OBS"):
        read_frames([path])
    with pytest.raises(TimeError, match="one for each"):
        read_frames([path], utc=["2021-08-05T05:30:00Z"] * 2)
    assert read_frames([path], utc=["2021-08-05T05:30:00Z"])[0].size == (30, 20)
    out = str(tmp_path / "missing" / "camera.json")
    assert main(["calibrate", path, "--lat", str(LAT_DEG), "--lon", str(LON_DEG), "--out", out]) == 2
    assert "folder does not exist" in capsys.readouterr().err
