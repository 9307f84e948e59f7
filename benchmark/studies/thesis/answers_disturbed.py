"""The answer about disturbances: H10."""

from __future__ import annotations

from benchmark.report.formatting import percent
from benchmark.stats.paired_tests import mcnemar_exact
from benchmark.studies.common.page_model import Answer, Cell, Comparison, Number, Table, family
from benchmark.studies.common.records import Rows
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.centroids import DISTURBANCES, DISTURBED_DEPTH_MAG, SHALLOW_DEPTH_MAG
from benchmark.studies.thesis.disturbed import CLEAR, FEW_STARS, NAMES, SETTINGS, part_of

SETTINGS_OF_LIGHT = tuple(setting for setting in SETTINGS if setting not in (CLEAR, FEW_STARS))


def h10(rows: Rows) -> Answer:
    """Cloud, Moon, blur, motion and hot pixels against a list of stars that ends at magnitude 4."""
    tests = family(
        [
            (
                f"{name}: {FEW_STARS} against {setting}",
                mcnemar_exact(rows.of(part_of(FEW_STARS), name).near, rows.of(part_of(setting), name).near),
            )
            for name in (who.ADAPTIVE, who.BRIGHTEST_N)
            for setting in SETTINGS_OF_LIGHT
        ]
    )
    verdict, sentence = _verdict(tests[: len(SETTINGS_OF_LIGHT)])
    few, clear = (rows.of(part_of(setting), who.ADAPTIVE).recall() for setting in (FEW_STARS, CLEAR))
    return Answer(
        "H10",
        "Clouds, the Moon, blur and hot pixels hurt more than limiting magnitude.",
        verdict,
        (
            f"The adaptive variant fixes {percent(clear.value)} of {clear.n} pictures of a clear, moonless night with stars "
            f"to magnitude 7, and {percent(few.value)} of the same pictures with stars to magnitude 4 alone, the thesis' "
            f"hardest label. {sentence}",
            "All pictures are of the same sites and instants. How strong a disturbance is was chosen, not found: other "
            "clouds, trails or sensors give other numbers. Without light, on positions alone, the second table says what "
            "missing and false detections do.",
        ),
        (_light_table(rows), _positions_table(rows)),
        tests,
    )


def _verdict(tests: tuple[Comparison, ...]) -> tuple[str, str]:
    """Verdict and sentence, from the adaptive variant's comparisons, a setting each."""
    worse = [s for s, test in zip(SETTINGS_OF_LIGHT, tests, strict=True) if test.first_is_better]
    better = [s for s, test in zip(SETTINGS_OF_LIGHT, tests, strict=True) if test.second_is_better]
    parts = []
    if worse:
        parts.append(f"Worse than that (5 % after Holm): {', '.join(worse)}.")
    if better:
        parts.append(f"Less bad than that: {', '.join(better)}.")
    if len(worse) + len(better) < len(SETTINGS_OF_LIGHT):
        same = [s for s in SETTINGS_OF_LIGHT if s not in worse and s not in better]
        parts.append(f"No difference found: {', '.join(same)}.")
    verdict = "yes" if len(worse) == len(SETTINGS_OF_LIGHT) else "for some" if worse else "no"
    return verdict, " ".join(parts)


def _light_table(rows: Rows) -> Table:
    body: list[tuple[Cell, ...]] = []
    for setting in SETTINGS:
        found = [rows.of(part_of(setting), name) for name in NAMES]
        cells: list[Cell] = [setting, *(Number(one.recall(), "percent") for one in found)]
        body.append((*cells, Number(found[0].median_km()), str(len(found[0]))))
    return Table(
        "Recall under disturbances of light",
        "rendered frames, the same sites and instants in every row; bortle 1, Sun 12 deg below the horizon",
        ("setting", *NAMES, f"{who.ADAPTIVE}: median km", "frames"),
        tuple(body),
    )


def _positions_table(rows: Rows) -> Table:
    names = (who.ADAPTIVE, who.BRIGHTEST_N)
    settings = [(kind, DISTURBED_DEPTH_MAG) for kind in DISTURBANCES] + [("none", SHALLOW_DEPTH_MAG)]
    body: list[tuple[Cell, ...]] = []
    for kind, depth in settings:
        found = [rows.of(f"disturbed: {kind}", name, (depth,)) for name in names]
        cells = [Number(one.recall(), "percent") for one in found]
        body.append((f"{kind}, stars to mag {depth:g}", *cells, str(len(found[0]))))
    return Table(
        "Recall under disturbed positions",
        "centroid frames, 0.3 px of noise",
        ("setting", *names, "frames"),
        tuple(body),
    )
