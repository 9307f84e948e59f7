"""Sentences of the pages: which solver is best, which differences are significant, and the provenance of results."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence

from benchmark.frames.frame_set import FrameFacts
from benchmark.report.formatting import percent
from benchmark.report.site.boards import Board, Entry
from benchmark.report.site.revisions import revision_words
from benchmark.report.site.tree import StoredResult
from benchmark.run.identities import identities_in
from benchmark.run.provenance import SEVERAL, Renewal
from benchmark.solvers.isolation import NOT_ISOLATED
from benchmark.stats.comparison import LEVEL
from benchmark.stats.paired_tests import holm
from generator.identity.revision import GENERATOR_REVISION

NOT_RECORDED = "not recorded"


def site_verdict(boards: Sequence[Board]) -> str:
    """Conclusion from the leaderboard, in a sentence or two.

    The best solver of a board leads if its least certain comparison with another, adjusted for all pairs of the board, stays
    significant when it is adjusted for all boards too.
    """
    compared = [board for board in boards if len(board.entries) > 1]
    if not compared:
        return "One solver to each comparison: nothing to rank yet."
    leads: Counter[str] = Counter()
    for board, p_value in zip(compared, holm([_lead_p(board) for board in compared]), strict=True):
        if p_value <= LEVEL:
            leads[board.entries[0].label] += 1
    parts = [f"{name} leads {count}" for name, count in leads.most_common()]
    if open_ := len(compared) - sum(leads.values()):
        parts.append(f"in {open_} the first place is not decided")
    noun = "comparisons" if len(compared) != 1 else "comparison"
    return (
        f"Of {len(compared)} {noun} (a task in one mode of detections; 5 % level for all together): {'; '.join(parts)}."
    )


def _lead_p(board: Board) -> float:
    """P-value of the first place: that of the least certain of its comparisons, adjusted for all pairs of the board."""
    best = board.entries[0].label
    return max(pair.success_p_holm for pair in board.comparisons if best in (pair.first, pair.second))


def left_out_words(part: StoredResult, whole: StoredResult) -> str:
    """Why a result on a part of another's frames is on no page, and the remedy."""
    return (
        f"left out: {part.folder}: has {len(part.frames)} of the {len(whole.frames)} frames of {whole.folder.name}; run it "
        "on all of them, or give runs on a part an --out of their own"
    )


def board_verdict(board: Board) -> str:
    """Which solver is best on a board, and whether this is certain."""
    best = board.entries[0]
    head = f"{best.label} succeeds most often: {percent(best.success.value)} of the frames."
    if len(board.entries) == 1:
        return head
    rivals = [entry.label for entry in board.entries[1:] if entry.rank.low == 1]
    tail = (
        f" It cannot be told from {', '.join(rivals)}."
        if rivals
        else " All others test as worse than some solver (5 % level, all pairs)."
    )
    found = board.discrimination
    if found is None:
        return head + tail
    graded = (
        f" {found.n_informative} of {found.n_conditions} conditions tell solvers apart (some success between 5 % and"
        f" 95 %); at the hardest the best reaches {percent(found.best_at_hardest)}."
    )
    return head + tail + graded


def detectable_words(board: Board) -> str:
    """The minimum detectable difference, in words."""
    if len(board.entries) < 2:
        return "One solver alone: no difference to detect."
    if board.detectable != board.detectable:
        return (
            "Minimum detectable difference: none; the solvers differ on too few frames for any difference to be found "
            "with a probability of 80 % (5 % level, all pairs)."
        )
    return (
        f"Minimum detectable difference: {100.0 * board.detectable:.1f} points of success between a typical pair of "
        f"solvers are found with a probability of 80 % (5 % level, adjusted for all pairs). Smaller ones may exist."
    )


def processor_words(boards: Sequence[Board]) -> str:
    """Say that times are of several processors, and of one board which are of which; empty where all can be compared."""
    timed: defaultdict[str, set[str]] = defaultdict(set)
    for board in boards:
        for entry in board.entries:
            timed[entry.stored.provenance.machine.get("cpu", "unknown")].add(entry.label)
    if len(timed) < 2:
        return ""
    if len(boards) > 1:
        names = joined(name for processors in timed for name in processors.split(SEVERAL))
        return f"Times are of several processors ({names}): compare those that a task's page allows."
    listed = "; ".join(f"{', '.join(sorted(labels))} on {processor}" for processor, labels in sorted(timed.items()))
    return f"Times of different processors are not comparable: {listed}."


def run_words(entry: Entry) -> str:
    """Provenance of one result."""
    run = entry.stored.provenance
    machine = (
        f"{run.machine.get('cpu', 'unknown')} ({run.machine.get('cores', '?')} cores, {run.machine.get('system', '?')})"
    )
    versions = ", ".join(f"{name} {version}" for name, version in sorted(run.versions.items()))
    found = f" ({entry.stored.established})" if entry.stored.established else ""
    return (
        f"{revision_words(entry)}{found}; key {entry.stored.key}, version {run.solver.version}, "
        f"detector {run.solver.detector}, run {run.date_utc} with {run.jobs} process{'es' if run.jobs != 1 else ''} "
        f"on {machine}; isolated: {_isolation_words(run.solver.isolation)}; {versions}{_renewal_words(run.renewed)}"
    )


def _renewal_words(renewed: Renewal | None) -> str:
    """How many answers are from an earlier run."""
    if renewed is None:
        return ""
    revision = renewed.rendered_with.get(GENERATOR_REVISION, NOT_RECORDED)
    return (
        f"; {renewed.n_kept} of {renewed.n_kept + renewed.n_solved} answers are of runs from {renewed.date_utc} on, on the "
        f"same frames, to the byte, by generator's revision {revision}; {renewed.n_solved} frames solved again"
    )


def _isolation_words(isolation: str | None) -> str:
    if isolation is None:
        return "not recorded"
    return "no" if isolation == NOT_ISOLATED else f"yes ({isolation})"


def _generator_words(frames: FrameFacts) -> str:
    """Revision of the generator, and the later one that rendered the same frames."""
    first = frames.rendered_with.get(GENERATOR_REVISION, "")
    again = (frames.rendered_again_with or {}).get(GENERATOR_REVISION)
    return f"{first}; {again} renders the same frames, to the byte" if again else first


def board_provenance(board: Board) -> tuple[tuple[str, str], ...]:
    """Provenance of a board."""
    frames = board.entries[0].stored.provenance.frames
    versions = {name: version for name, version in frames.rendered_with.items() if name != GENERATOR_REVISION}
    rendered = ", ".join(f"{name} {version}" for name, version in sorted(versions.items()))
    head: tuple[tuple[str, str], ...] = (
        ("frames", f"{frames.target} ({board.task.key}, {board.split})"),
        ("scenario", f"{frames.scenario_name}, SHA-256 {frames.scenario_sha256}"),
        ("truth", f"SHA-256 {frames.truth_sha256}" if frames.truth_sha256 else ""),
        ("hashes of frames", _hashes_words(board)),
        ("generator's revision", _generator_words(frames)),
        ("rendered with", rendered),
    )
    if frames.frozen is not None:
        settled = ", ".join(f"{name} {revision}" for name, revision in sorted(frames.frozen.items()))
        head += (("solvers settled before the frames were drawn", settled or "none"),)
    stated = tuple((name, words) for name, words in head if words)
    lacking = ", ".join(name for name, words in head if not words)
    if lacking:
        stated += ((NOT_RECORDED, lacking),)
    return stated + tuple((entry.label, run_words(entry)) for entry in board.entries)


def _hashes_words(board: Board) -> str:
    """One hash over all images and truths, in the order of the frames' ids; empty where a result states none."""
    digest = hashlib.sha256()
    found = identities_in(board.entries[0].stored.frames)
    for name in sorted(found):
        if found[name].image_sha256 is None or found[name].truth_sha256 is None:
            return ""
        digest.update(f"{name}:{found[name].image_sha256}:{found[name].truth_sha256};".encode())
    return f"of image and truth of each of {len(found)} frames, together SHA-256 {digest.hexdigest()}"


def site_provenance(boards: Sequence[Board]) -> tuple[tuple[str, str], ...]:
    """Provenance of all results on the pages."""
    runs = [entry.stored.provenance for board in boards for entry in board.entries]
    dates = sorted(run.date_utc for run in runs)
    return (
        ("runs", f"{len(runs)}, from {dates[0]} to {dates[-1]}"),
        ("skybench", joined(run.versions.get("skybench", "unknown") for run in runs)),
        ("machines", joined(name for run in runs for name in run.machine.get("cpu", "unknown").split(SEVERAL))),
        ("in detail", "at the foot of each task's and each solver's page"),
    )


def joined(values: Iterable[str]) -> str:
    """Join the values, without duplicates, in order."""
    return ", ".join(sorted(set(values)))
