"""Hills of an elevation raster: map projection, curvature, refraction, what hides what, files and refusals."""

import numpy as np
import pytest
import yaml
from elevation_files import ASCII, DOUBLE, WGS84_KEYS, utm_keys, write_elevation
from geographiclib.geodesic import Geodesic
from PIL import Image
from small_scenes import BASE

from generator.errors import ScenarioError
from generator.frame.landscape import landscape_maps, sky_light
from generator.frame.plan import plan_frame
from generator.frame.scene import frame_layers
from generator.ground.lighting import ROWS
from generator.ground.panorama import column_azimuths, row_altitudes
from generator.ground.terrain import outlook as outlook_module
from generator.ground.terrain.geotiff import MOST_TEXELS, Elevation, ElevationError, Grid, read_elevation
from generator.ground.terrain.outlook import elevation_angle_deg, outlook
from generator.ground.terrain.transverse_mercator import utm
from generator.light.photometry import GRID_NM
from generator.scenario.file import parse_scenario

EARTH_M = 6371e3
PLACE = 47.0, 11.0
"""Zone 32, two degrees east of its middle: true north is 1.5 deg from the grid's."""
AZIMUTHS = column_azimuths(720)
ALTITUDES = row_altitudes(1650, 75.0, -90.0)


def test_utm_against_published_coordinates() -> None:
    """33.3 N, 44.4 E: 38N 444140.54 3684706.36 (the example of GeographicLib's GeoConvert); in the middle of a zone the
    northing is 0.9996 of the geodesic from the equator, in the southern hemisphere less than 10,000 km by as much."""
    np.testing.assert_allclose(utm(np.array(33.3), np.array(44.4), 38, False), (444140.54, 3684706.36), atol=0.006)
    for latitude in (-60.0, 15.0, 71.0):
        arc = Geodesic.WGS84.Inverse(0, 9, abs(latitude), 9)["s12"]
        easting, northing = utm(np.array(latitude), np.array(9.0), 32, latitude < 0)
        assert easting == pytest.approx(500e3, abs=1e-6)
        assert northing == pytest.approx(0.9996 * arc if latitude > 0 else 1e7 - 0.9996 * arc, abs=1e-5)


@pytest.mark.parametrize(("distance_km", "drop_m"), [(10, 6.8), (30, 61.5), (100, 683)])
def test_curvature_and_refraction_lower_what_is_far(distance_km, drop_m) -> None:
    """Of surveyors: (1 - k) d^2 / 2 R, 0.0683 d^2 metres at d kilometres for k = 0.13."""
    seen = float(elevation_angle_deg(np.array(1000.0 * distance_km), np.array(500.0), 500.0, EARTH_M))
    assert -np.tan(np.radians(seen)) * 1000 * distance_km == pytest.approx(drop_m, rel=0.005)


def peak_file(path, corner, pixel, shape, column, row, keys=WGS84_KEYS, **options):
    """A cone 2000 m high over a plain at 200 m, 20 pixels in radius."""
    y, x = np.indices(shape)
    height = 200 + 2000 * np.maximum(1 - np.hypot(x - column, y - row) / 20, 0)
    write_elevation(path, height, corner, pixel, keys, **options)


@pytest.mark.parametrize("projection", ["geographic", "utm"])
@pytest.mark.parametrize(("azimuth", "distance_m"), [(40.0, 30_000.0), (262.0, 45_000.0)])
def test_a_peak_is_where_the_geodesic_leads(tmp_path, projection, azimuth, distance_m) -> None:
    """A cone 2000 m above the plain, at a place by GeographicLib: azimuth within a pixel's half width, elevation within 2 %
    of h / d - (1 - k) d / 2 R (samples pass the top by up to a quarter of a pixel, 1.2 % of the height), never above."""
    there = Geodesic.WGS84.Direct(*PLACE, azimuth, distance_m)
    path = tmp_path / "peak.tif"
    if projection == "utm":
        pixel = 100.0
        here = [float(part) for part in utm(np.array(PLACE[0]), np.array(PLACE[1]), 32, False)]
        peak = [float(part) for part in utm(np.array(there["lat2"]), np.array(there["lon2"]), 32, False)]
        corner = peak[0] - 600.5 * pixel, peak[1] + 600.5 * pixel
        if azimuth > 180:
            corner = peak[0] - 100.5 * pixel, corner[1]
        assert corner[0] < here[0] < corner[0] + 1200 * pixel
        column = 100 if azimuth > 180 else 600
        peak_file(path, corner, pixel, (1200, 1200), column, 600, utm_keys(32632))
    else:
        pixel = 0.001
        corner = there["lon2"] - 600.5 * pixel, there["lat2"] + 600.5 * pixel
        if azimuth > 180:
            corner = there["lon2"] - 100.5 * pixel, corner[1]
        column = 100 if azimuth > 180 else 600
        peak_file(path, corner, pixel, (1200, 1200), column, 600)
    elevation = read_elevation(path.read_bytes(), "peak.tif")
    directions = azimuth + np.arange(-400, 401) * 0.005
    seen = outlook(elevation, PLACE, 1.6, directions, ALTITUDES)
    assert seen.ground_m == 200
    wanted = 2000 / distance_m - (1 - 0.13) * distance_m / (2 * 6378e3)
    assert 0.98 * wanted < np.tan(np.radians(seen.edge_deg.max())) < 1.001 * wanted
    above = seen.edge_deg > 0.75 * seen.edge_deg.max()
    assert directions[above].mean() == pytest.approx(azimuth, abs=np.degrees(60 / distance_m))
    row = int(np.argmin(np.abs(ALTITUDES - 0.8 * seen.edge_deg.max())))
    # At four fifths of its height the cone's face is 400 m nearer.
    assert seen.distance_m[row, 400] == pytest.approx(distance_m - 400, rel=0.004)


def test_dip_of_the_sea() -> None:
    """From 1000 m over the sea: 1.926 arcmin times the root of the height in metres without refraction (Bowditch), times the
    root of 1 - k with it; every direction, within 1 %."""
    grid = Grid(((500.0, 0.0, 500.0), (0.0, -500.0, 500.0)))
    sea = Elevation(np.zeros((1001, 1001), np.float32), grid)
    place = 0.0, 0.0
    seen = outlook(sea, place, 1000.0, AZIMUTHS, ALTITUDES)
    dip = 1.926 * np.sqrt(1000) * np.sqrt(1 - outlook_module.REFRACTION_COEFFICIENT) / 60
    np.testing.assert_allclose(seen.edge_deg, -dip, rtol=0.01)


def test_a_ridge_hides_what_is_behind(tmp_path) -> None:
    """A wall of 300 m along the grid's east at 5 km, one of 1000 m at 15 km: elevations by distance / cos(azimuth from the
    wall's normal); up to the first wall's edge its distance, above it the second's."""
    here = [float(part) for part in utm(np.array(PLACE[0]), np.array(9.0), 32, False)]
    height = np.zeros((1000, 800))
    pixel = 30.0
    corner = here[0] - 400.5 * pixel, here[1] + 900.5 * pixel
    for away, top in ((5000.0, 300.0), (15000.0, 1000.0)):
        height[899 - round(away / pixel) : 902 - round(away / pixel)] = top
    write_elevation(tmp_path / "walls.tif", height, corner, pixel, utm_keys(25832), compression="tiff_deflate")
    elevation = read_elevation((tmp_path / "walls.tif").read_bytes(), "walls.tif")
    azimuth = np.array([340.0, 0.0, 15.0])
    seen = outlook(elevation, (PLACE[0], 9.0), 2.0, azimuth, ALTITUDES)
    for k, turn in enumerate(np.radians(azimuth)):
        for away, top in ((4980.0, 300.0), (14970.0, 1000.0)):
            distance = away / np.cos(turn)
            angle = np.degrees(np.arctan((top - 2) / distance - 0.87 * distance / (2 * 6.38e6)))
            row = int(np.argmin(np.abs(ALTITUDES - 0.93 * angle)))
            assert seen.distance_m[row, k] == pytest.approx(distance, rel=0.01), (azimuth[k], away)
        assert seen.edge_deg[k] == pytest.approx(angle, abs=0.02), azimuth[k]


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.float32, np.uint16])
def test_kinds_of_numbers_and_missing_values(tmp_path, kind) -> None:
    """All kinds give the same heights; -32768, or another number said to stand for none, is none."""
    missing = 65535 if kind == np.uint16 else -32768
    height = np.arange(12.0).reshape(3, 4) * 10
    height[0, 0] = missing
    write_elevation(tmp_path / "any.tif", height, (10.0, 48.0), 0.5, nodata=str(missing), kind=kind)
    elevation = read_elevation((tmp_path / "any.tif").read_bytes(), "any.tif")
    assert np.isnan(elevation.height_m[0, 0])
    np.testing.assert_array_equal(elevation.height_m.ravel()[1:], height.ravel()[1:])
    assert elevation.at_place(47.25, 11.0) == (55.0, 11.0)
    assert elevation.at_place(47.25, 371.0) == (55.0, 11.0)
    assert elevation.at_place(47.75, 10.3) is None
    assert elevation.at_place(40.0, 10.3) is None


def test_points_and_whole_matrices(tmp_path) -> None:
    """A raster of points begins in the middle of its first pixel; a matrix of the transformation stands for scale and tie."""
    height = np.arange(12.0).reshape(3, 4)
    points = tuple((1025, 0, 1, 2) if key[0] == 1025 else key for key in WGS84_KEYS)
    write_elevation(tmp_path / "points.tif", height, (10.0, 48.0), 0.5, points)
    assert read_elevation((tmp_path / "points.tif").read_bytes(), "x").at_place(47.5, 10.5) == (5.0, 10.5)
    matrix = (0.5, 0, 0, 10.0, 0, -0.5, 0, 48.0, 0, 0, 0, 0, 0, 0, 0, 1.0)
    tags = {33550: None, 33922: None, 34264: (DOUBLE, matrix)}
    write_elevation(tmp_path / "matrix.tif", height, (0, 0), 1, tags=tags)
    assert read_elevation((tmp_path / "matrix.tif").read_bytes(), "x").at_place(47.25, 10.75) == (5.0, 10.75)


REFUSED = {
    "GeoKeyDirectory": {"tags": {34735: None}},
    "ModelPixelScale": {"tags": {33550: None}},
    "no size": {"pixel": (0.0, 0.0)},
    "ProjectedCSType is 2056": {"keys": utm_keys(2056)},
    "ProjectedCSType is 32661": {"keys": utm_keys(32661)},
    "ProjLinearUnits is 9002": {"keys": (*utm_keys(32632)[:3], (3076, 0, 1, 9002))},
    "VerticalUnits is 9002": {"keys": (*WGS84_KEYS, (4099, 0, 1, 9002))},
    "GeographicType is 32767": {"keys": (*WGS84_KEYS[:2], (2048, 0, 1, 32767))},
    "GTModelType is 3": {"keys": ((1024, 0, 1, 3),)},
    "latitude 3999": {"corner": (7.0, 4000.0)},
    "heights from -32768": {"height_m": np.full((3, 4), -32768.0)},
    "all heights are missing": {"height_m": np.full((3, 4), -1.0), "nodata": "-1"},
    "not a number": {"nodata": "none"},
    "infinite": {"height_m": np.full((3, 4), np.inf)},
    "as pictures have": {"kind": np.uint8},
    "too few": {"height_m": np.zeros((1, 4))},
    "damaged": {"tags": {34735: (3, (1, 1, 0, 60000))}},
    "tie points": {"tags": {33922: (DOUBLE, (0.0,) * 12)}},
    "expected 16": {"tags": {34264: (DOUBLE, (1.0, 2.0))}},
    "cannot be read": {"tags": {33550: (ASCII, "wide")}},
}


@pytest.mark.parametrize("message", sorted(REFUSED))
def test_refused_files(tmp_path, message) -> None:
    given = {"height_m": np.zeros((3, 4)), "corner": (10.0, 48.0), "pixel": 0.5} | REFUSED[message]
    write_elevation(tmp_path / "odd.tif", **given)
    with pytest.raises(ElevationError, match=message) as caught:
        read_elevation((tmp_path / "odd.tif").read_bytes(), "odd.tif")
    assert "odd.tif" in str(caught.value)


def test_large_cut_and_foreign_files(tmp_path) -> None:
    """The size is judged before a pixel is decoded; a file cut anywhere is refused."""
    path = tmp_path / "large.tif"
    write_elevation(path, np.zeros((64, 64)), (10.0, 48.0), 0.01)
    whole = path.read_bytes()
    Image.new("I;16", (MOST_TEXELS // 4 + 8, 4)).save(tmp_path / "wide.tif", compression="tiff_deflate")
    assert (tmp_path / "wide.tif").stat().st_size < 200_000
    with pytest.raises(ElevationError, match="at most"):
        read_elevation((tmp_path / "wide.tif").read_bytes(), "wide.tif")
    for data in (b"", b"II*\0", b"\x89PNG" + whole, whole[:200], whole[:-5000]):
        with pytest.raises(ElevationError, match=r"large\.tif"):
            read_elevation(data, "large.tif")


CAMERA = {"width": 240, "height": 160, "hfov_deg": 50, "aperture_mm": 4.0, "bloom": {"share": 0}, "veiling_glare": 0}


def scene(folder, landscape, latitude=47.0, **overrides):
    site = {"latitude_deg": latitude, "longitude_deg": 11.0}
    attitude = {"azimuth_deg": 0, "altitude_deg": 5}
    tree = BASE | {"camera": CAMERA, "site": site, "attitude": attitude, "stars": {"limiting_magnitude": 5.0}}
    tree = tree | {"foreground": {"landscape": landscape}} | overrides
    return parse_scenario(yaml.safe_dump(tree), str(folder / "scene.yaml"))


def test_scenario_with_an_elevation_raster(tmp_path) -> None:
    """It needs a height at the site; it goes with skylines, not with a picture."""
    height = np.zeros((400, 400))
    height[20] = 3000.0
    write_elevation(tmp_path / "hills.tif", height, (10.8, 47.3), 0.001)
    spec = scene(tmp_path, {"dem": "hills.tif"}).frame(0)
    assert spec.foreground.landscape is not None
    with pytest.raises(ScenarioError, match=r"foreground\.landscape\.dem: 'hills\.tif' has no height at the site"):
        scene(tmp_path, {"dem": "hills.tif"}, latitude=50.0).frame(0)
    with pytest.raises(ScenarioError, match="give either file"):
        scene(tmp_path, {"dem": "hills.tif", "file": "hills.tif"})
    with pytest.raises(ScenarioError, match="azimuth_deg belongs to a picture"):
        scene(tmp_path, {"dem": "hills.tif", "azimuth_deg": 30.0})


@pytest.mark.journey
def test_far_hills_fade_into_the_sky_at_the_horizon(tmp_path) -> None:
    """Koschmieder's law: the light of a wall 31 km away in haze of 1 / km is that of the sky at the horizon there; in clear
    air its part is 1 - exp(-extinction x distance), the rest that of its own dark surface."""
    height = np.zeros((400, 400))
    height[20] = 3000.0
    write_elevation(tmp_path / "hills.tif", height, (10.8, 47.3), 0.001)
    response = np.ones((1, len(GRID_NM)))
    light = {}
    for tau in (1.5, 0.03):
        atmosphere = {"aerosol_tau_550": tau}
        plan = plan_frame(scene(tmp_path, {"dem": "hills.tif"}, atmosphere=atmosphere, sky={"bortle": 4}), 0)
        tables = list(frame_layers(plan).values())
        maps = landscape_maps(plan, tables, response)
        assert maps is not None
        assert maps.surface.at(3.0, 0.0)[0] == 1
        sky = sky_light(plan, tables)
        cells = (sky.maps.T @ sky.spectra).sum(axis=1).reshape(-1, 2 * ROWS)
        light[tau] = float(maps.signal(3.0, 0.0)[0]), float(cells[-1, [0, -1]].mean())
    assert light[1.5][0] == pytest.approx(light[1.5][1], rel=0.01)
    # 31.1 km of 0.03 / 1.5 and of Rayleigh's 0.0973 / 8 per km.
    through = np.exp(-31.1 * (0.02 + 0.0122))
    share = light[0.03][0] / light[0.03][1]
    assert 1 - through < share < 1 - 0.93 * through
