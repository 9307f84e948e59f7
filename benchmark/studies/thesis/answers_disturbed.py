"""The answer about disturbances: H10."""

from __future__ import annotations

from dataclasses import dataclass

from benchmark.stats.intervals import Estimate
from benchmark.studies.common.page_model import Answer, Cell, Number, Outcome, Table, Verdict, family
from benchmark.studies.common.records import Rows, near_test
from benchmark.studies.thesis import contestants as who
from benchmark.studies.thesis.centroids import DISTURBANCES, DISTURBED_DEPTH_MAG, SHALLOW_DEPTH_MAG
from benchmark.studies.thesis.disturbed import CLEAR, FEW_STARS, NAMES, SETTINGS, part_of
from benchmark.studies.thesis.hypotheses import CLAIMS

SETTINGS_OF_LIGHT = tuple(setting for setting in SETTINGS if setting not in (CLEAR, FEW_STARS))


@dataclass(frozen=True)
class DisturbedRecalls:
    """H10: the adaptive variant's recalls, and settings by their effect compared with a list of stars to magnitude 4.

    Attributes
    ----------
    clear, few_stars : Estimate
        With stars to magnitude 7 and to magnitude 4.
    worse, better, undecided : tuple of str
        Disturbances that cost more than the short list of stars, less, or, according to the tests, neither.
    """

    clear: Estimate
    few_stars: Estimate
    worse: tuple[str, ...]
    better: tuple[str, ...]
    undecided: tuple[str, ...]


def h10(rows: Rows) -> Answer:
    """Compare cloud, Moon, blur, motion and hot pixels with a list of stars that ends at magnitude 4."""
    tests = family(
        [
            (
                f"{name}: {FEW_STARS} against {setting}",
                near_test(rows.of(part_of(FEW_STARS), name), rows.of(part_of(setting), name)),
            )
            for name in (who.ADAPTIVE, who.BRIGHTEST_N)
            for setting in SETTINGS_OF_LIGHT
        ]
    )
    settings: dict[Outcome, list[str]] = {outcome: [] for outcome in Outcome}
    # Only for the adaptive variant; a setting is worse where frames with few stars do better.
    for setting, test in zip(SETTINGS_OF_LIGHT, tests, strict=False):
        settings[test.outcome].append(setting)
    worse = settings[Outcome.BETTER]
    verdict = Verdict.YES if len(worse) == len(SETTINGS_OF_LIGHT) else Verdict.FOR_SOME if worse else Verdict.NO
    few, clear = (rows.of(part_of(setting), who.ADAPTIVE).recall() for setting in (FEW_STARS, CLEAR))
    return Answer(
        "H10",
        CLAIMS["H10"],
        (("", verdict),),
        DisturbedRecalls(
            clear, few, tuple(worse), tuple(settings[Outcome.WORSE]), tuple(settings[Outcome.NO_DIFFERENCE])
        ),
        (_light_table(rows), _positions_table(rows)),
        tests,
    )


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
