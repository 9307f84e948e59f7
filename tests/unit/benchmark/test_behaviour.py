"""Revisions of solvers: what changes them, what does not, and whose."""

from __future__ import annotations

import ast
import functools
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import celnav
from benchmark.solvers.definition import FOLDER, SolverFolder, read_solver_folder
from benchmark.solvers.registry import known_solvers, solver_folder, solvers_by_themselves
from benchmark.solvers.revision import (
    PackageTree,
    adapter_behaviour,
    detector_behaviour,
    installed_packages,
    revision_of,
)
from generator.identity.behaviour import Entry, Sources, behaviour_of, syntax_digest

THESIS = {
    "brightest-n",
    "thesis-adaptive",
    "thesis-baseline",
    "thesis-baseline+si",
    "thesis-baseline+si+pr",
    "thesis-catalogue-only",
}
CELNAV = THESIS | {"ddr-dai", "skybench"}
TETRA3RS = {"tetra3rs", "tetra3rs-calibrated"}
PEERS = TETRA3RS | {"ruststartracker", "zenith-fixer"}
LEARNED = {"learned"}
DETECTOR = "the shared detector"


def digests(sources: Sources) -> dict[str, str]:
    """Digest of the modules of every solver with an adapter, and of the detector."""
    solvers = [solver_folder(name) for name in known_solvers()]
    found = {
        solver.name: adapter_behaviour(sources, solver.spec.adapter, solver.name).digest
        for solver in solvers
        if solver.spec.adapter is not None
    }
    return found | {DETECTOR: detector_behaviour(sources).digest}


@functools.cache
def digests_as_installed() -> dict[str, str]:
    """Digests of the code that is installed."""
    return digests(installed_packages().sources)


def changed(**edits: tuple[str, str]) -> set[str]:
    """Whose digests differ after edits of modules, each an old text and a new one; dots are underscores twice."""
    installed = installed_packages().sources
    texts = {}
    for name, (old, new) in edits.items():
        module = name.replace("__", ".")
        text = installed.modules[module]
        assert old in text, f"{module} has no {old!r}: this test needs another place to change"
        texts[module] = text.replace(old, new, 1)
    before, after = digests_as_installed(), digests(installed.edited(texts))
    return {name for name in before if before[name] != after[name]}


def reformatted(text: str) -> str:
    """Another layout of the same code, with comments and docstrings of its own."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            node.body.insert(0, ast.Expr(ast.Constant("Said otherwise.")))
    return "# A remark.\n" + ast.unparse(ast.fix_missing_locations(tree)).replace("\n", "  # why\n", 1)


def test_comments_docstrings_and_formatting_of_all_modules_change_nobody() -> None:
    installed = installed_packages().sources
    modules = {name: reformatted(text) for name, text in installed.modules.items()}
    assert sum(modules[name] != text for name, text in installed.modules.items()) > 100
    assert digests(Sources(modules, installed.packages)) == digests_as_installed()


@pytest.mark.parametrize(
    ("module", "whose"),
    [
        ("celnav.matching.votes", THESIS),
        ("celnav.matching.ddr_dai", {"ddr-dai"}),
        ("celnav.matching.brightest_n", {"brightest-n"}),
        ("celnav.identification.search", {"skybench"}),
        ("celnav.skybench_solver", {"skybench"}),
        ("celnav.detecting.star_shape", CELNAV | LEARNED | {DETECTOR}),
        ("celnav.position", CELNAV),
        ("celnav.sequences.track", CELNAV),
        ("celnav.sequences.night", set()),
        ("celnav.command.arguments", set()),
        ("benchmark.solvers.tetra3rs.adapter", TETRA3RS),
        ("benchmark.solvers.pinhole", PEERS | LEARNED),
        ("benchmark.solvers.learned.patterns", LEARNED),
        ("benchmark.solvers.celnav_solver", CELNAV),
        ("benchmark.report.formatting", set()),
    ],
)
def test_a_change_of_a_module_changes_exactly_the_solvers_that_import_it(module: str, whose: set[str]) -> None:
    text = installed_packages().sources.modules[module]
    assert changed(**{module.replace(".", "__"): (text, text + "\nANOTHER = 1\n")}) == whose


def test_of_the_registry_a_row_changes_its_own_solver() -> None:
    old, new = '"thesis-adaptive": ddr_solver(THESIS_ADAPTIVE)', '"thesis-adaptive": ddr_solver(THESIS_BASELINE)'
    assert changed(celnav__solver=(old, new)) == {"thesis-adaptive"}
    added = 'MappingProxyType(\n    {\n        "one-more": ddr_solver(THESIS_ADAPTIVE),'
    assert changed(celnav__solver=("MappingProxyType(\n    {", added)) == set()


def test_of_the_server_what_answers_a_request_counts() -> None:
    everyone = CELNAV | PEERS | LEARNED
    assert changed(benchmark__solvers__serve=('uv": np.asarray(', 'uv": 1.0 * np.asarray(')) == everyone
    assert changed(benchmark__solvers__serve=("os.dup2(2, 1)", "os.dup2(1, 2)")) == set()


def test_the_detector_is_all_that_is_loaded_to_detect() -> None:
    """The modules found in the source are those that a fresh process has after importing the detector alone.

    Packages that only pass names on are left out on both sides.
    """
    code = (
        "import sys, types; package = types.ModuleType('celnav'); package.__path__ = sys.argv[1:]; "
        "sys.modules['celnav'] = package; import celnav.detection; "
        "import json; print(json.dumps(sorted(m for m in sys.modules if m.startswith('celnav.') "
        "and not hasattr(sys.modules[m], '__path__'))))"
    )
    folder = Path(sys.modules["celnav"].__file__ or "").parent
    run = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=True)
    assert tuple(json.loads(run.stdout)) == detector_behaviour(installed_packages().sources).modules


def sources_of(**files: str) -> Sources:
    return Sources.of_files({name.replace("__", "/") + ".py": text for name, text in files.items()})


def test_imports_within_functions_count_and_those_for_types_do_not() -> None:
    sources = sources_of(
        p__a="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p import types\n"
        "def f():\n    from p.late import g\n    return g()\n",
        p__late="import p.deep\ndef g(): return p.deep.X\n",
        p__deep="X = 1",
        p__types="T = int",
    )
    assert behaviour_of(sources, Entry([("p.a", "f")])).modules == ("p.a", "p.deep", "p.late")


def test_a_package_that_passes_names_on_leads_to_their_modules() -> None:
    sources = Sources.of_files(
        {
            "p/__init__.py": '"""All."""\nfrom p.a import f\nfrom p.b import g\n__all__ = ["f", "g"]\n',
            "p/a.py": "def f(): return 1",
            "p/b.py": "def g(): return 2",
            "q/uses.py": "import p\ndef h(): return p.f()",
            "q/all.py": "import p\nh = vars(p)",
        }
    )
    assert behaviour_of(sources, Entry([("q.uses", "")])).modules == ("p.a", "q.uses")
    assert behaviour_of(sources, Entry([("q.all", "")])).modules == ("p", "p.a", "p.b", "q.all")


LATE = """from typing import TYPE_CHECKING
from p.a import f
if TYPE_CHECKING:
    from p.b import g
def __getattr__(name):
    'Late.'
    if name == "g":
        from p.b import g
        {more}
        return g
    raise AttributeError(name)
"""


def test_a_package_that_passes_names_on_late_leads_to_their_modules() -> None:
    modules = {
        "p/a.py": "def f(): return 1",
        "p/b.py": "def g(): return 2",
        "q/early.py": "from p import f",
        "q/late.py": "import p\ndef h(): return p.g()",
    }
    sources = Sources.of_files(modules | {"p/__init__.py": LATE.format(more="")})
    assert behaviour_of(sources, Entry([("q.early", "")])).modules == ("p.a", "q.early")
    assert behaviour_of(sources, Entry([("q.late", "")])).modules == ("p.b", "q.late")
    working = Sources.of_files(modules | {"p/__init__.py": LATE.format(more="print(name)")})
    assert behaviour_of(working, Entry([("q.early", "")])).modules == ("p", "p.a", "p.b", "q.early")


def test_a_package_with_code_of_its_own_counts() -> None:
    sources = Sources.of_files({"p/__init__.py": "import numpy\nnumpy.seterr(all='raise')", "p/a.py": "X = 1"})
    assert behaviour_of(sources, Entry([("p.a", "X")])).modules == ("p", "p.a")


def test_another_origin_of_the_same_name_changes_a_shared_module() -> None:
    one = "from p.a import f\nfrom p.b import g\nTABLE = {'x': (f, g)}"
    other = "from p.b import f\nfrom p.a import g\nTABLE = {'x': (f, g)}"
    functions = "def f(): return {0}\ndef g(): return {0}"
    entry = Entry([("p.t", "TABLE")], ["p.t"], "x")
    found = {
        behaviour_of(sources_of(p__t=text, p__a=functions.format(1), p__b=functions.format(2)), entry).digest
        for text in (one, other)
    }
    assert len(found) == 2


def test_the_order_of_imports_is_free_and_that_of_statements_is_not() -> None:
    assert syntax_digest("import b\nimport a\nX = 1") == syntax_digest("import a\nimport b\n\nX = 1\n")
    assert syntax_digest("X = 1\nY = 2") != syntax_digest("Y = 2\nX = 1")
    assert syntax_digest("X = 1") != syntax_digest("X = 1.0")
    assert syntax_digest("X = True") != syntax_digest("X = 'True'")


def test_relative_imports_are_refused() -> None:
    with pytest.raises(ValueError, match=r"p\.a, line 1: a relative import"):
        behaviour_of(sources_of(p__a="from . import b"), Entry([("p.a", "")]))


def test_no_module_that_solvers_import_hides_an_import_in_a_string() -> None:
    for name in known_solvers():
        solver = solver_folder(name)
        if solver.spec.adapter is not None:
            for module in adapter_behaviour(installed_packages().sources, solver.spec.adapter, name).modules:
                text = installed_packages().sources.modules[module]
                assert "import_module(" not in text, module
                assert "__import__(" not in text, module


def program(folder: Path, text: str, spec: str = "") -> SolverFolder:
    folder.mkdir(exist_ok=True)
    (folder / "program.py").write_text(text)
    settings = 'name: own\ntitle: A program\nlicence: MIT\nversion: "1"\ncommand: [python, program.py]\n'
    (folder / "solver.yaml").write_text(settings + spec)
    return read_solver_folder(folder)


def test_of_a_program_every_byte_counts_because_it_can_read_its_own_files(tmp_path: Path) -> None:
    before = program(tmp_path, "print(1)").revision
    for text in ('"""What it is for."""\nprint(1)', "print(1)  # 48.1 N", "print( 1 )", "print(2)"):
        assert program(tmp_path, text).revision != before
    assert program(tmp_path, "print(1)", "time_limit_s: 3\n").revision != before
    assert program(tmp_path, "print(1)", "# 48.1 N\n").revision != before
    (tmp_path / "README.md").write_text("# What it is")
    assert program(tmp_path, "print(1)").revision == before
    (tmp_path / "more").mkdir()
    (tmp_path / "more" / "README.md").write_text("# Only that of the folder is for readers")
    assert program(tmp_path, "print(1)").revision != before
    shutil.rmtree(tmp_path / "more")
    (tmp_path / "weights.csv").write_text("1")
    assert program(tmp_path, "print(1)").revision != before


@pytest.fixture
def packages(tmp_path: Path) -> PackageTree:
    """Today's packages in another tree, whose solvers may be edited."""
    shutil.copytree(FOLDER, tmp_path / "benchmark" / "solvers", ignore=shutil.ignore_patterns("__pycache__"))
    found = PackageTree(tmp_path)
    found.__dict__["sources"] = installed_packages().sources
    found.__dict__["catalogues"] = installed_packages().catalogues
    return found


@pytest.mark.parametrize("name", solvers_by_themselves())
def test_what_a_contestants_readme_says_changes_nothing(name: str, packages: PackageTree) -> None:
    solver = solver_folder(name)
    copy = read_solver_folder(packages.solvers / solver.folder.name)
    (copy.folder / "README.md").unlink(missing_ok=True)
    assert copy.revision_among(packages) == solver.revision


def test_of_programs_that_come_with_skybench_the_syntax_counts(packages: PackageTree) -> None:
    solver = solver_folder("seiza")
    copy = read_solver_folder(packages.solvers / "seiza")
    text = (copy.folder / "program.py").read_text()
    (copy.folder / "program.py").write_text(f"# a comment\n{text}")
    assert copy.revision_among(packages) == solver.revision
    (copy.folder / "program.py").write_text(f"{text}\nprint()\n")
    assert copy.revision_among(packages) != solver.revision


def test_what_a_solver_yaml_says_for_readers_changes_nothing(tmp_path: Path) -> None:
    solver = solver_folder("tetra3rs")
    texts = {
        "same": (solver.folder / "solver.yaml").read_text(),
        "title": (solver.folder / "solver.yaml").read_text().replace("title: ", "title: The "),
        "version": (solver.folder / "solver.yaml").read_text().replace("tetra3rs==0.14.0", "tetra3rs==0.15.0"),
    }
    found = {}
    for name, text in texts.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "solver.yaml").write_text(text)
        found[name] = read_solver_folder(tmp_path / name).revision
    assert found["same"] == found["title"] == solver.revision
    assert found["version"] != solver.revision


def test_what_makes_a_pinhole_s_image_counts_for_programs_that_know_only_pinholes() -> None:
    packages = PackageTree(Path(celnav.__file__).parents[1])
    name = "benchmark.run.pinhole_frames"
    text = packages.sources.modules[name]
    assert "order=3" in text
    packages.__dict__["sources"] = packages.sources.edited({name: text.replace("order=3", "order=1")})
    solvers = [solver_folder(one) for one in ("cedar-solve", "seiza", "astrometry-net", "tetra3rs")]
    changed = {solver.name for solver in solvers if solver.revision_among(packages) != solver.revision}
    assert changed == {"cedar-solve", "seiza", "astrometry-net"}


def test_the_star_catalogues_count_where_they_are_read() -> None:
    sources = installed_packages().sources
    skybench, zenith = (
        adapter_behaviour(sources, adapter, name)
        for adapter, name in (("celnav", "skybench"), ("zenith-fixer", "zenith-fixer"))
    )
    assert revision_of({}, {}, skybench, "one") != revision_of({}, {}, skybench, "other")
    assert revision_of({}, {}, zenith, "one") == revision_of({}, {}, zenith, "other")


def test_each_file_of_the_star_catalogue_counts(tmp_path) -> None:
    celnav_data = Path(celnav.__file__).parent / "data"
    copied = tmp_path / "celnav" / "data"
    shutil.copytree(celnav_data, copied)
    assert PackageTree(tmp_path).catalogues == installed_packages().catalogues
    tables = [path for path in sorted(copied.rglob("*")) if path.suffix in {".dat", ".csv"}]
    assert len(tables) == 2
    for table in tables:
        content = table.read_bytes()
        table.write_bytes(content + b"\n")
        assert PackageTree(tmp_path).catalogues != installed_packages().catalogues, table
        table.write_bytes(content)
    shutil.rmtree(copied / "tycho2")
    assert PackageTree(tmp_path).catalogues != installed_packages().catalogues  # an older checkout


def test_revisions_are_twelve_digits_and_tell_solvers_apart() -> None:
    found = [solver_folder(name).revision for name in known_solvers()]
    assert len(set(found)) == len(found)
    for revision in (*found, installed_packages().detector_revision):
        assert len(revision) == 12
        assert int(revision, 16) >= 0
