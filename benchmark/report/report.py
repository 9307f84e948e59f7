"""The report: one HTML file that needs nothing beside it, and the table for the terminal."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup
from rich.table import Table

from benchmark.errors import ResultsError
from benchmark.judge.star_id import BLEND_SHARE, MATCH_RADIUS_PX, TRACE_SNR
from benchmark.report import charts
from benchmark.report.contact_sheet import MAX_FRAMES, make_cards
from benchmark.report.formatting import HEADLINE
from benchmark.report.templates import render_page
from benchmark.run.results import SolverResult, read_results, write_atomically
from benchmark.stats.metrics import DEFINITIONS, SUCCESS_KM

REPORT_NAME = "report.html"


def write_report(out: Path, commands: Sequence[str] | None = None) -> Path:
    """Write ``report.html`` from the results in a folder.

    Parameters
    ----------
    out : Path
        Results folder of `benchmark.run.run.run_benchmark`.
    commands : sequence of str, optional
        Shell commands that make the report again; by default those of the benchmark alone.

    Returns
    -------
    Path
        Of the file written.

    Raises
    ------
    ResultsError
        The folder holds no results, damaged ones, or more solvers than the figures can tell apart.
    """
    results = read_results(out)
    if len(results) > charts.MAX_SERIES:
        raise ResultsError(
            f"{out}: results of {len(results)} solvers; the figures tell {charts.MAX_SERIES} apart, "
            f"move some of them to another folder"
        )
    path = out / REPORT_NAME
    write_atomically(path, _render(out, results, commands or _commands(out, results)).encode())
    return path


def result_table(out: Path) -> Table:
    """Headline table of the results in a folder, for the terminal.

    Raises
    ------
    ResultsError
        As for `write_report`.
    """
    results = read_results(out)
    first = results[0]
    title = f"{first.provenance.scenario_name}: {first.overall.n_frames} frames (95 % intervals in brackets)"
    table = Table(title=title, title_justify="left")
    table.add_column("", no_wrap=True)
    for result in results:
        table.add_column(result.solver, justify="left", overflow="fold")
    for column in HEADLINE:
        cells = [f"{column.value(r.overall)} [dim]\\[{column.interval(r.overall)}][/dim]" for r in results]
        table.add_row(column.heading, *cells)
    table.add_row("fixes, refused, errors", *[_counts(result) for result in results])
    return table


def _counts(result: SolverResult) -> str:
    return f"{result.overall.n_fixes}, {result.overall.n_refused}, {result.overall.n_errors}"


def _commands(out: Path, results: Sequence[SolverResult]) -> list[str]:
    provenance = results[0].provenance
    solvers = " ".join(f"--solver {shlex.quote(result.solver)}" for result in results)
    dataset, folder = shlex.quote(provenance.dataset), shlex.quote(out.name or ".")
    return [
        f"skybench bench run {dataset} {solvers} --out {folder}",
        f"skybench bench report --out {folder}",
    ]


def _render(out: Path, results: Sequence[SolverResult], commands: Sequence[str]) -> str:
    cards = make_cards(out, results)
    return render_page(
        "report.html",
        results=results,
        provenance=results[0].provenance,
        n_frames=results[0].overall.n_frames,
        columns=HEADLINE,
        classes=charts.summaries_by_class(results),
        smallest_class=min(summary.n_frames for result in results for _, summary in result.bortle),
        recall_svg=Markup(charts.recall_by_bortle(results)),
        median_svg=Markup(charts.median_error_by_bortle(results)),
        star_recall_svg=Markup(charts.star_recall_by_bortle(results)),
        distribution_svg=Markup(charts.error_distribution(results)),
        cards=cards,
        all_shown=len(cards) == results[0].overall.n_frames,
        max_frames=MAX_FRAMES,
        commands=commands,
        definitions=DEFINITIONS,
        success_km=f"{SUCCESS_KM:g}",
        radius_px=f"{MATCH_RADIUS_PX:g}",
        blend_share=f"{100 * BLEND_SHARE:g} %",
        trace_snr=f"{TRACE_SNR:g}",
    )
