"""The part of the replication that needs no pictures: star positions with noise, in two projections.

Frames of one site at several depths share the site, the instant and the noise stream, so that they can be compared in pairs.
"True star" experiments omit identification: the solver receives the identities of the stars.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import celnav
from benchmark.judge.geodesy import geodesic_km
from benchmark.studies.common.centroid_frames import CentroidFrame, Projection, StarList, list_stars, make_frame
from benchmark.studies.common.contestants import Contestant, judge_detections
from benchmark.studies.common.records import Row, row_of
from benchmark.studies.thesis import contestants as who
from celnav.matching.polar import smallest_determinant
from generator.scenario.file import Scenario
from generator.seeds import random_stream

F8 = NDArray[np.float64]

DEPTHS_MAG = (2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0)
DEEPEST_MAG = 6.5
NOISE_PX = 0.3
NOISES_PX = (0.0, 0.1, 0.3)
ATTITUDE_ERRORS_DEG = (0.0, 0.01, 0.03, 0.1, 0.3)
FIX_DEPTH_MAG = 4.0
ONE_STAR_DEPTHS_MAG = (4.0, 3.0)
POLAR_DEG = 75.0
CHOICES = ("most central", "|dec| <= 75", "det J >= cos 75", "largest det J of 10", "all stars")
DISTURBANCES = ("none", "20 % missing", "20 % false", "50 hot pixels", "half clouded")
DISTURBED_DEPTH_MAG, SHALLOW_DEPTH_MAG = 5.0, 3.0


@dataclass(frozen=True)
class OneStar:
    """A fix from one identified star.

    Attributes
    ----------
    projection : str
        Projection of the frame; it is solved as a pinhole's.
    depth_mag : float
        Uses the most central star down to this magnitude.
    noise_px, off_axis_deg, error_km : float
    """

    projection: Projection
    depth_mag: float
    noise_px: float
    off_axis_deg: float
    error_km: float


@dataclass(frozen=True)
class TrueStarFix:
    """A fix from identified stars, under a choice of stars or an attitude error.

    Attributes
    ----------
    experiment : str
        ``choice`` or ``attitude``.
    setting : str
        Choice of stars, or the attitude's standard deviation in degrees about each axis.
    site : int
    error_km : float
        Infinite where no star was left.
    """

    experiment: str
    setting: str
    site: int
    error_km: float


@dataclass(frozen=True)
class CentroidPart:
    """All results from star positions without pictures."""

    n_sites: int
    rows: tuple[Row, ...]
    one_star: tuple[OneStar, ...]
    true_stars: tuple[TrueStarFix, ...]


def sites_of(scenario: Scenario, n_sites: int) -> list[StarList]:
    """List the stars to magnitude 6.5 over sites of a scenario, whatever the limiting magnitude of its sets.

    Sites are drawn as the scenario draws its own, in frames after its last one.
    """
    tree = {**scenario.template, "stars": {"limiting_magnitude": DEEPEST_MAG}}
    deep = replace(scenario, name=f"{scenario.name}-centroids", template=tree, axes=(), repeats=n_sites)
    return [list_stars(deep, index) for index in range(n_sites)]


def solve_centroids(sites: Sequence[StarList], n_identified: int) -> CentroidPart:
    """Run all experiments on centroids.

    Parameters
    ----------
    sites : sequence of StarList
        Experiments with true names use all of them.
    n_identified : int
        Experiments that identify stars are slower and only use this number of them.
    """
    one_star = [fix for stars in sites for fix in _one_star_fixes(stars)]
    true_stars = [fix for number, stars in enumerate(sites) for fix in _true_star_fixes(number, stars)]
    sites = sites[:n_identified]
    rows = [*_by_depth(sites), *_histories(sites), *_projections(sites), *_disturbances(sites)]
    return CentroidPart(len(sites), tuple(rows), tuple(one_star), tuple(true_stars))


def _judged(part: str, depth: float, made: CentroidFrame, contestants: Sequence[Contestant], warm: bool) -> list[Row]:
    outcomes = judge_detections(made.frame, made.detections, contestants, warm_up=warm)
    return [row_of(part, depth, c.name, outcome) for c, outcome in zip(contestants, outcomes, strict=True)]


def _by_depth(sites: Sequence[StarList]) -> list[Row]:
    contestants = [*who.registered(), *who.literal()]
    rows: list[Row] = []
    for depth in DEPTHS_MAG:
        for stars in sites:
            made = make_frame(stars, depth, noise_px=NOISE_PX)
            rows += _judged("centroids", depth, made, contestants, warm=not rows)
    return rows


def _histories(sites: Sequence[StarList]) -> list[Row]:
    """The literal adaptive variant at depths 2.0 to 4.5: no history, carried at one depth, carried shuffled."""
    depths = [depth for depth in DEPTHS_MAG if depth <= 4.5]
    frames = [(depth, make_frame(stars, depth, noise_px=NOISE_PX)) for depth in depths for stars in sites]
    solver = celnav.ddr_solver(who.LITERAL[who.LITERAL_ADAPTIVE])
    shuffled = random_stream(2, "study.order_of_frames", 0).permutation(len(frames))
    rows = []
    for order in ("reset", "carried, one depth", "carried, shuffled"):
        history, last = celnav.History(), math.nan
        places = shuffled if order.endswith("shuffled") else np.arange(len(frames))
        found: dict[int, Row] = {}
        for place in places:
            depth, made = frames[int(place)]
            if order == "reset" or (order == "carried, one depth" and depth != last):
                history, last = celnav.History(), depth
            found[int(place)] = _judged("literal history", depth, made, [Contestant(order, solver, history)], False)[0]
        rows += [found[place] for place in sorted(found)]
    return rows


def _projections(sites: Sequence[StarList]) -> list[Row]:
    """Frames in either projection, solved as a pinhole's, with patterns of three radii."""
    contestants = [who.adaptive_of_radius(f"literal adaptive, {radius} deg", radius) for radius in (20, 45, 60)]
    contestants += [c for c in who.registered() if c.name in (who.ADAPTIVE, who.DAI)]
    rows: list[Row] = []
    projections: tuple[Projection, ...] = ("pinhole", "stereographic")
    for projection in projections:
        for depth in (3.0, 4.0):
            for stars in sites:
                made = make_frame(stars, depth, projection, NOISE_PX)
                rows += _judged(f"projection {projection}", depth, made, contestants, warm=not rows)
    return rows


def _disturbances(sites: Sequence[StarList]) -> list[Row]:
    contestants = [c for c in who.registered() if c.name in (who.ADAPTIVE, who.BRIGHTEST_N)]
    rows: list[Row] = []
    for stars in sites:
        for depth in (DISTURBED_DEPTH_MAG, SHALLOW_DEPTH_MAG):
            for kind in DISTURBANCES if depth == DISTURBED_DEPTH_MAG else DISTURBANCES[:1]:
                made = disturb(make_frame(stars, depth, noise_px=NOISE_PX), kind)
                rows += _judged(f"disturbed: {kind}", depth, made, contestants, warm=not rows)
    return rows


def disturb(made: CentroidFrame, kind: str) -> CentroidFrame:
    """Remove detections or add false ones: the effect of clouds, hot pixels and noise on positions, without their light.

    Parameters
    ----------
    made : CentroidFrame
    kind : str
        One of `DISTURBANCES`.
    """
    if kind not in DISTURBANCES:
        raise ValueError(f"disturbance {kind!r} is not one of {', '.join(DISTURBANCES)}")
    found, camera = made.detections, made.frame.observation.camera
    uv, flux = found.uv, np.asarray(found.flux)
    draw = random_stream(3, f"study.disturb.{kind}", made.frame.index)
    if kind == "20 % missing":
        keep = draw.random(len(uv)) >= 0.2
        uv, flux = uv[keep], flux[keep]
    elif kind == "half clouded":
        keep = uv[:, 0] >= camera.cx_px
        uv, flux = uv[keep], flux[keep]
    elif kind in ("20 % false", "50 hot pixels"):
        n = round(0.2 * len(uv)) if kind == "20 % false" else 50
        false_uv = draw.uniform([0, 0], [camera.width - 1, camera.height - 1], (n, 2))
        # False stars have the brightness of stars; hot pixels are as bright as the brightest.
        false_flux = draw.choice(flux, n) if kind == "20 % false" else np.full(n, flux.max())
        uv, flux = np.vstack((uv, false_uv)), np.concatenate((flux, false_flux))
    order = np.argsort(-flux, kind="stable")
    return replace(made, detections=celnav.Detections(uv[order], flux[order], found.shape))


def _error_km(made: CentroidFrame, rows: Sequence[int] | NDArray[np.intp], attitude: F8 | None = None) -> float:
    """Error of a fix from detections with supplied names."""
    frame = made.frame
    chosen = np.asarray(rows, dtype=np.intp)
    if len(chosen) == 0:
        return math.inf
    observation = frame.observation
    camera = celnav.Camera.pinhole(observation.camera.width, observation.camera.height, 120.0)
    camera = replace(camera, f_px=observation.camera.f_px, fy_px=observation.camera.fy_px)
    fix = celnav.fix_position(
        made.detections.uv[chosen],
        frame.truth.star_id[chosen],
        camera,
        observation.utc,
        observation.R_cam if attitude is None else attitude,
    )
    if not fix.ok:
        return math.inf
    site = frame.conditions
    return geodesic_km(site.latitude_deg, site.longitude_deg, fix.lat_deg, fix.lon_deg)


def _off_axis_deg(made: CentroidFrame, projection: Projection) -> F8:
    """True angle between each star of a frame and the optical axis, shape (n,), degrees."""
    camera = made.frame.observation.camera
    r = np.hypot(*(made.frame.truth.uv - [camera.cx_px, camera.cy_px]).T) / camera.f_px
    return np.degrees(np.arctan(r) if projection == "pinhole" else 2 * np.arctan(r / 2))


def _one_star_fixes(stars: StarList) -> list[OneStar]:
    fixes = []
    projections: tuple[Projection, ...] = ("pinhole", "stereographic")
    for projection, depth in itertools.product(projections, ONE_STAR_DEPTHS_MAG):
        for noise_px in NOISES_PX:
            made = make_frame(stars, depth, projection, noise_px)
            off_axis = _off_axis_deg(made, projection)
            star = int(np.argmin(off_axis))
            fixes.append(OneStar(projection, depth, noise_px, float(off_axis[star]), _error_km(made, [star])))
    return fixes


def _true_star_fixes(site: int, stars: StarList) -> list[TrueStarFix]:
    made = make_frame(stars, FIX_DEPTH_MAG, noise_px=NOISE_PX)
    order = np.argsort(_off_axis_deg(made, "pinhole"), kind="stable")
    dec_deg = dict(zip(stars.star_id.tolist(), stars.dec_deg.tolist(), strict=True))
    declination = np.radians([dec_deg[star] for star in made.frame.truth.star_id.tolist()])
    camera, R_cam = made.frame.observation.camera, made.frame.observation.R_cam
    rays = np.column_stack((made.detections.uv - [camera.cx_px, camera.cy_px], np.full(len(order), camera.f_px)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    determinant = np.array([smallest_determinant(ray @ R_cam, dec) for ray, dec in zip(rays, declination, strict=True)])
    limit = math.cos(math.radians(POLAR_DEG))
    chosen: dict[str, NDArray[np.intp]] = {
        "most central": order[:1],
        "|dec| <= 75": order[np.abs(np.degrees(declination))[order] <= POLAR_DEG][:1],
        "det J >= cos 75": order[determinant[order] >= limit][:1],
        "largest det J of 10": order[:10][[int(np.argmax(determinant[order[:10]]))]],
        "all stars": order,
    }
    fixes = [TrueStarFix("choice", name, site, _error_km(made, rows)) for name, rows in chosen.items()]
    turn = random_stream(4, "study.attitude_error", stars.plan.index).normal(0.0, 1.0, 3)
    for sigma_deg in ATTITUDE_ERRORS_DEG:
        wrong = R_cam @ Rotation.from_rotvec(sigma_deg * turn, degrees=True).as_matrix()
        fixes.append(TrueStarFix("attitude", f"{sigma_deg:g}", site, _error_km(made, order, wrong)))
    return fixes
