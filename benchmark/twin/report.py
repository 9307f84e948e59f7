"""The comparison of photographs with their twins as tables, as numbers, and as pictures side by side."""

from __future__ import annotations

import dataclasses
import io
import itertools
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from benchmark.twin.comparison import NAMED_MAG, SKY_EDGES_DEG
from benchmark.twin.star_bins import plain_bins, snr_by_magnitude, width_by_angle
from benchmark.twin.twin import StackRange, Twin
from generator.files import write_bytes

NUMBERS, TABLES = "twins.json", "twins.md"
SNR_BINS, WIDTH_BINS = "snr_by_magnitude", "width_by_angle"
"""Keys of the numbers by bins of stars (`benchmark.twin.star_bins`)."""
LOW_QUANTILE, HIGH_QUANTILE = 0.01, 0.995
"""Quantiles of the photograph's sky that become black and white in both pictures."""
GAMMA = 2.0
WEATHER = {
    "airglow_factor": "airglow",
    "aerosol_tau_550": "aerosol",
    "cloud_tau": "cloud",
    "cloud_cover": "cover",
    "cloud_draw": "draw",
    "city_factor": "cities",
    "focus_factor": "focus",
    "zenith_mag_arcsec2": "zenith, mag",
    "gain_factor": "gain",
    "black_level_dn": "black level",
}
"""Titles of the numbers that are fitted."""
SIDE_PX = 620
"""Width of each picture."""


def numbers_of_twin(twin: Twin) -> dict[str, Any]:
    """Numbers that describe a twin; ratios are photograph over twin, medians those of stars to V 4.5."""
    real, made = twin.real, twin.made
    named = real.stars.v_mag < NAMED_MAG
    seen = named & _both(real.snr, made.snr)
    return {
        "photograph": twin.photograph.name,
        "utc_start": twin.photograph.utc_start,
        "exposure_s": twin.photograph.exposure_s,
        "sun_altitude_deg": round(twin.sun_altitude_deg, 2),
        "moon_altitude_deg": round(twin.moon_altitude_deg, 2),
        "alignment": {
            "stars": twin.alignment.stars,
            "rms_px": _finite(twin.alignment.rms_px),
            "turned_deg": round(twin.alignment.turned_deg, 4),
        },
        "weather": {name: _finite(value) for name, value in dataclasses.asdict(twin.weather).items()},
        "stack": None if twin.ranges is None else [_range(each) for each in twin.ranges],
        "detections": {
            name: {
                "real": getattr(real, name),
                "twin": getattr(made, name),
                "ratio": _finite(getattr(real, name) / max(getattr(made, name), 1)),
                "spurious_real": _finite(getattr(real, f"{name}_spurious")),
                "spurious_twin": _finite(getattr(made, f"{name}_spurious")),
            }
            for name in ("celnav", "sep")
        },
        "sky_edges_deg": list(SKY_EDGES_DEG),
        "sky_ratio": [_finite(value) for value in real.sky / made.sky],
        "noise_ratio": _finite(real.noise / made.noise),
        "autocorrelation_real": [_finite(value) for value in real.autocorrelation],
        "autocorrelation_twin": [_finite(value) for value in made.autocorrelation],
        "spectrum_ratio": [_finite(value) for value in real.spectrum / made.spectrum],
        "stars": int(seen.sum()),
        "snr_ratio": _finite(_median_ratio(real.snr[named], made.snr[named])),
        "flux_ratio": _finite(_median_ratio(real.flux[named], made.flux[named])),
        "nearest_share_real": _finite(_median(real.nearest_share[seen])),
        "nearest_share_twin": _finite(_median(made.nearest_share[seen])),
        SNR_BINS: plain_bins(snr_by_magnitude(real, made)),
        WIDTH_BINS: plain_bins(width_by_angle(real, made)),
    }


def tables_of(rows: Sequence[dict[str, Any]]) -> str:
    """The numbers of some twins as three Markdown tables."""
    bands = [f"{low}-{high}" for low, high in itertools.pairwise(SKY_EDGES_DEG)]
    fitted = {name: title for name, title in WEATHER.items() if any(name in row["weather"] for row in rows)}
    sky = _table(
        ("photograph", "Moon, deg", *fitted.values(), *bands, "noise"),
        [
            (
                row["photograph"],
                f"{row['moon_altitude_deg']:.0f}",
                *(_shown(row["weather"].get(name), 2) for name in fitted),
                *(_shown(value, 2) for value in row["sky_ratio"]),
                _shown(row["noise_ratio"], 2),
            )
            for row in rows
        ],
    )
    detections = _table(
        ("photograph", "celnav", "spurious", "in the twin", "sep", "spurious", "in the twin", "stars", "SNR", "flux"),
        [
            (
                row["photograph"],
                *(
                    text
                    for name in ("celnav", "sep")
                    for text in (
                        f"{row['detections'][name]['real']} / {row['detections'][name]['twin']} = "
                        f"{row['detections'][name]['ratio']:.2f}",
                        _percent(row["detections"][name]["spurious_real"]),
                        _percent(row["detections"][name]["spurious_twin"]),
                    )
                ),
                str(row["stars"]),
                _shown(row["snr_ratio"], 2),
                _shown(row["flux_ratio"], 2),
            )
            for row in rows
        ],
    )
    noise = _table(
        (
            "photograph",
            "neighbours, real",
            "neighbours, twin",
            "power by band",
            "nearest pixel, real",
            "nearest pixel, twin",
        ),
        [
            (
                row["photograph"],
                " ".join(_shown(value, 3) for value in row["autocorrelation_real"]),
                " ".join(_shown(value, 3) for value in row["autocorrelation_twin"]),
                " ".join(_shown(value, 2) for value in row["spectrum_ratio"]),
                _shown(row["nearest_share_real"], 3),
                _shown(row["nearest_share_twin"], 3),
            )
            for row in rows
        ],
    )
    tables = [sky, detections, noise]
    stacks = [row for row in rows if row["stack"] is not None]
    if stacks:
        tables.append(_stack_table(stacks))
    return "\n".join(tables)


def _stack_table(rows: Sequence[dict[str, Any]]) -> str:
    """Quantiles of the pictures of stacks, photograph / twin."""
    keys = ("deviation_dn", "above_mean_dn")
    return _table(
        ("photograph", "`STDPIXEL`, 10, 50, 90 %, real / twin", "maximum over mean, 10, 50, 90 %, real / twin"),
        [
            (
                row["photograph"],
                *(
                    " / ".join(", ".join(f"{value:.0f}" for value in part[key]) for part in row["stack"])
                    for key in keys
                ),
            )
            for row in rows
        ],
    )


def _range(stack: StackRange) -> dict[str, Any]:
    return {"deviation_dn": stack.deviation.tolist(), "above_mean_dn": stack.above_mean.tolist()}


def side_by_side(twin: Twin) -> NDArray[np.uint8]:
    """The photograph and its twin, on one grey scale, (height, width)."""
    real, made = twin.photograph.pixels, twin.pixels.astype(np.float32)
    low, high = np.quantile(real[twin.sky], [LOW_QUANTILE, HIGH_QUANTILE])
    # The darkest sky is dark grey, so that darker ground remains visible.
    low = max(low - 0.5 * (high - low), float(real.min()))
    height = round(SIDE_PX * real.shape[0] / real.shape[1])
    sheet = Image.new("L", (2 * SIDE_PX, height))
    for number, pixels in enumerate((real, made)):
        grey = np.clip((pixels - low) / max(high - low, 1e-6), 0, 1) ** (1 / GAMMA)
        picture = Image.fromarray(np.rint(255 * grey).astype(np.uint8)).resize((SIDE_PX, height), Image.Resampling.BOX)
        sheet.paste(picture, (number * SIDE_PX, 0))
        label = f"{twin.photograph.name}: {'photograph' if number == 0 else 'rendered twin'}"
        ImageDraw.Draw(sheet).text((number * SIDE_PX + 8, 6), label, fill=255)
    return np.asarray(sheet, dtype=np.uint8)


def write_report(rows: Sequence[dict[str, Any]], folder: Path) -> None:
    """Write the numbers (JSON) and the tables (Markdown)."""
    write_bytes(folder / NUMBERS, (json.dumps({"twins": list(rows)}, indent=1, allow_nan=False) + "\n").encode())
    write_bytes(folder / TABLES, tables_of(rows).encode())


def write_picture(twin: Twin, folder: Path) -> Path:
    """Write the pair of pictures and return its path."""
    stream = io.BytesIO()
    Image.fromarray(side_by_side(twin)).save(stream, format="JPEG", quality=85)
    path = folder / f"{twin.photograph.name}.jpg"
    write_bytes(path, stream.getvalue())
    return path


def _both(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(one) & np.isfinite(other) & (other > 0))


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else math.nan


def _median_ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    both = _both(one, other)
    return _median(one[both] / other[both])


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(float(value), 4)


def _shown(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
