"""The parts of a set of Python modules that affect the behaviour of one entry: the modules that it imports, and a digest.

The modules are found from the source alone, by following import statements from an entry, including those inside
functions. Importing the solver in a fresh process and listing ``sys.modules`` would not help: a package's ``__init__``
imports everything that the package offers, and an import inside a branch appears only if an input happens to take the
branch. The source gives the same answer on every machine, and for every commit.

Two kinds of modules are not included as a whole but examined:

* A package's ``__init__`` that consists only of imports and ``__all__`` merely passes names on. ``from package import
  name`` leads to the module that defines the name, and so does ``package.name`` after ``import package``. A
  ``__getattr__`` that only imports a name on first access also passes names on.
* A *shared* module, such as a registry of solvers, serves several entries. Only those of its statements count that the
  entry needs, and only those rows of its tables that have the entry's key.

Any other module counts as a whole. Its digest is that of its syntax tree without docstrings, so it does not depend on
comments, docstrings, the order of imports or formatting. Code whose module is named only by a string is not found.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

_IMPORTS = (ast.Import, ast.ImportFrom)
_DEFINITIONS = (*_IMPORTS, ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign)


@dataclass(frozen=True)
class Sources:
    """Source files of packages: text by dotted module name; a package's name denotes its ``__init__``.

    Attributes
    ----------
    modules : mapping of str to str
        Text of each module.
    packages : collection of str
        Modules that are packages.
    """

    modules: Mapping[str, str]
    packages: Collection[str]
    _read: dict[str, _Module] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of_files(cls, files: Mapping[str, str]) -> Sources:
        """Create from files by their paths relative to the folder that contains the packages, such as ``celnav/fix.py``."""
        modules, packages = {}, set()
        for path, text in files.items():
            name = path.removesuffix(".py").replace("/", ".")
            if name.endswith(".__init__"):
                name = name.removesuffix(".__init__")
                packages.add(name)
            modules[name] = text
        return cls(modules, packages)

    def edited(self, texts: Mapping[str, str]) -> Sources:
        """Return the same modules, with other texts for some of them."""
        read = {name: module for name, module in self._read.items() if name not in texts}
        return Sources({**self.modules, **texts}, self.packages, read)

    def module(self, name: str) -> _Module:
        """Read a module.

        Raises
        ------
        KeyError
            There is no such module.
        SyntaxError, ValueError
            It is not Python, or contains a relative import.
        """
        if name not in self._read:
            self._read[name] = _Module(_parse(self.modules[name], name), name in self.packages)
        return self._read[name]


@dataclass(frozen=True)
class _Module:
    """A module's syntax, and properties that are determined once for all entries."""

    tree: ast.Module
    is_package: bool

    @cached_property
    def digest(self) -> str:
        return _sha256(_canonical_body(self.tree.body))

    @cached_property
    def imports(self) -> tuple[ast.Import | ast.ImportFrom, ...]:
        """All import statements in the module."""
        return tuple(node for node in _run(self.tree) if isinstance(node, _IMPORTS))

    @cached_property
    def origins(self) -> dict[str, tuple[str, str]]:
        """Names that its own import statements bind, each with its module of origin and its name there."""
        late = [node for statement in self.tree.body for node in _passed_on_late(statement)]
        return _origins([*self.tree.body, *late])

    @cached_property
    def passes_on(self) -> bool:
        """Whether it is a package that only imports and lists its names, if necessary by a ``__getattr__``."""
        return self.is_package and all(
            isinstance(statement, _IMPORTS)
            or (isinstance(statement, ast.If) and _never_imported(statement.test) and not statement.orelse)
            or _passed_on_late(statement)
            or _defined(statement) == {"__all__"}
            for statement in self.tree.body
        )


@dataclass(frozen=True)
class Entry:
    """Starting point of a solver's code.

    Attributes
    ----------
    names : sequence of (str, str)
        Module and a name in it; an empty name means the whole module.
    shared : collection of str
        Modules that serve several entries, of which only the needed parts count.
    key : str or None
        Key of the entry in tables of shared modules: in a dictionary that has this key, only its row counts.
    """

    names: Sequence[tuple[str, str]]
    shared: Collection[str] = ()
    key: str | None = None


@dataclass
class Behaviour:
    """Everything that an entry reaches: whole modules, and statements of shared ones.

    Attributes
    ----------
    sources : Sources
    entry : Entry
    whole : set of str
        Modules that count as a whole.
    parts : dict of str to dict of int to ast.stmt
        Statements of shared modules that count, by their position in the module.
    imported : set of (str, str, str, str)
        Names that these statements import: module, name in it, module of origin and name there.
    """

    sources: Sources
    entry: Entry
    whole: set[str] = field(default_factory=set)
    parts: dict[str, dict[int, ast.stmt]] = field(default_factory=dict)
    imported: set[tuple[str, str, str, str]] = field(default_factory=set)

    @property
    def modules(self) -> tuple[str, ...]:
        """Names of all modules that are reached, sorted, without packages that only pass names on."""
        return tuple(sorted(self.whole | set(self.parts)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the syntax of everything that is reached, in hexadecimal digits."""
        content: list[object] = [sorted(self.imported)]
        for name in self.modules:
            taken = self.parts.get(name, {})
            part = _canonical_body([taken[place] for place in sorted(taken)])
            content.append([name, self.sources.module(name).digest if name in self.whole else part])
        return _sha256(content)

    def reach(self, module: str, name: str) -> None:
        """Follow a name of a module, and everything that it needs; names from third-party packages are not followed."""
        if f"{module}.{name}" in self.sources.modules:
            self._module(f"{module}.{name}")
        elif module in self.sources.modules:
            found = self.sources.module(module)
            origin = found.origins.get(name) if found.passes_on else None
            if origin is None:
                self._module(module, name)
            else:
                self.reach(*origin)

    def _module(self, module: str, name: str = "") -> None:
        parts = module.split(".")
        for parent in (".".join(parts[:n]) for n in range(1, len(parts))):
            if parent in self.sources.modules and not self.sources.module(parent).passes_on:
                self._module(parent)
        if module in self.entry.shared and name:
            self._part(module, name)
        elif module not in self.whole:
            self.whole.add(module)
            found = self.sources.module(module)
            for node in found.imports:
                self._follow(node, found.tree)

    def _part(self, module: str, name: str) -> None:
        """Include the statements of a shared module that define a name, and those that define nothing but are executed."""
        body = self.sources.module(module).tree.body
        if module not in self.parts:
            self.parts[module] = {}
            for place, statement in enumerate(body):
                main = isinstance(statement, ast.If) and _never_imported(statement.test)
                if not (main or isinstance(statement, _DEFINITIONS)):
                    self._take(module, place)
        for place, statement in enumerate(body):
            if not isinstance(statement, _IMPORTS) and name in _defined(statement):
                self._take(module, place)

    def _take(self, module: str, place: int) -> None:
        if place in self.parts[module]:
            return
        body = self.sources.module(module).tree.body
        statement = body[place] if self.entry.key is None else _row_of(body[place], self.entry.key)
        self.parts[module][place] = statement
        imported = self.sources.module(module).origins
        used = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)}
        for name in sorted(used):
            if name in imported:
                self.imported.add((module, name, *imported[name]))
            self._part(module, name)
        inside = [node for node in _run(statement) if isinstance(node, _IMPORTS)]
        above = [_narrowed(node, used) for node in body if isinstance(node, _IMPORTS)]
        for node in (*inside, *above):
            self._follow(node, statement)

    def _follow(self, node: ast.Import | ast.ImportFrom, within: ast.AST) -> None:
        """Follow an import statement whose names are used within some syntax."""
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                self.reach(node.module or "", "" if alias.name == "*" else alias.name)
        else:
            for alias in node.names:
                if alias.name in self.sources.modules and self.sources.module(alias.name).passes_on:
                    for name in sorted(_attributes(within, alias.asname or alias.name)):
                        self.reach(alias.name, name)
                else:
                    self.reach(alias.name, "")


def behaviour_of(sources: Sources, entry: Entry) -> Behaviour:
    """Follow an entry through the sources.

    Raises
    ------
    KeyError
        A module of the entry is not among the sources.
    SyntaxError
        A file that is reached is not Python.
    """
    found = Behaviour(sources, entry)
    for module, name in entry.names:
        sources.module(module)
        found.reach(module, name)
    return found


def syntax_digest(text: str) -> str:
    """SHA-256 of a Python text's syntax; comments, docstrings, formatting and the order of imports do not affect it.

    Raises
    ------
    SyntaxError
        The text is not Python.
    """
    return _sha256(_canonical_body(_parse(text, "").body))


def _sha256(content: object) -> str:
    return hashlib.sha256(json.dumps(content, ensure_ascii=True).encode()).hexdigest()


def _parse(text: str, name: str) -> ast.Module:
    tree = _without_docstrings(ast.parse(text, filename=name or "<text>"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            raise ValueError(f"{name}, line {node.lineno}: a relative import; write the package's name")
    return tree


def _without_docstrings(tree: ast.Module) -> ast.Module:
    """Remove every string that is a statement of its own: docstrings of modules, classes, functions and attributes."""
    for node in ast.walk(tree):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list):
                setattr(node, name, [one for one in block if not _is_idle(one)])
    return tree


def _is_idle(statement: ast.stmt) -> bool:
    """Whether it is a string or ``pass``, which a docstring may replace."""
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return isinstance(statement.value.value, str)
    return isinstance(statement, ast.Pass)


def _canonical_body(body: Sequence[ast.stmt]) -> list[object]:
    """Statements of a module: its imports sorted, name by name, then all others in their order."""
    imports = sorted(
        [getattr(node, "module", None) or "", getattr(node, "level", 0), alias.name, alias.asname or ""]
        for node in body
        if isinstance(node, _IMPORTS)
        for alias in node.names
    )
    return [imports, [_canonical(node) for node in body if not isinstance(node, _IMPORTS)]]


def _canonical(node: object) -> object:
    """Syntax as lists of names and values, the same for every version of Python because empty fields are left out."""
    if isinstance(node, ast.Constant):
        return [type(node.value).__name__, repr(node.value)]
    if isinstance(node, ast.AST):
        fields = [(name, getattr(node, name, None)) for name in node._fields]
        return [
            type(node).__name__,
            *([name, _canonical(value)] for name, value in fields if value is not None and value != []),
        ]
    if isinstance(node, list):
        return [_canonical(each) for each in node]
    return repr(node)


def _run(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node and everything below it that runs when its module is imported or used, so not ``if TYPE_CHECKING:``."""
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(node, ast.If) and _never_imported(node.test) and child in node.body):
            yield from _run(child)


def _never_imported(test: ast.expr) -> bool:
    """Whether it is ``TYPE_CHECKING`` or ``__name__ == "__main__"``."""
    if isinstance(test, ast.Compare):
        return isinstance(test.left, ast.Name) and test.left.id == "__name__"
    return (_dotted(test) or "").split(".")[-1] == "TYPE_CHECKING"


def _origins(body: Sequence[ast.stmt]) -> dict[str, tuple[str, str]]:
    found: dict[str, tuple[str, str]] = {}
    for node in body:
        if isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name: (node.module or "", alias.name) for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.asname: (alias.name, "") for alias in node.names if alias.asname}
            found |= {alias.name.split(".")[0]: (alias.name, "") for alias in node.names if not alias.asname}
    return found


def _passed_on_late(statement: ast.stmt) -> list[ast.stmt]:
    """Imports of a module's ``__getattr__`` (PEP 562) that does nothing else; empty for any other statement."""
    if not isinstance(statement, ast.FunctionDef) or statement.name != "__getattr__":
        return []
    body = statement.body[1:] if ast.get_docstring(statement) is not None else statement.body
    nodes = [node for each in body for node in ast.walk(each) if isinstance(node, ast.stmt)]
    passes = all(isinstance(node, (*_IMPORTS, ast.If, ast.Return, ast.Raise)) for node in nodes)
    return [node for node in nodes if isinstance(node, _IMPORTS)] if passes else []


def _defined(statement: ast.stmt) -> set[str]:
    """Names that a statement of a module defines."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {statement.name}
    return {node.id for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _narrowed(node: ast.Import | ast.ImportFrom, used: Collection[str]) -> ast.Import | ast.ImportFrom:
    """Reduce an import statement to the names that are used."""
    narrowed = copy.copy(node)
    narrowed.names = [alias for alias in node.names if (alias.asname or alias.name.split(".")[0]) in used]
    return narrowed


def _attributes(within: ast.AST, bound: str) -> set[str]:
    """Names of a module that are used as its attributes; the empty name if the module itself is used."""
    used, owners = set(), set()
    for node in ast.walk(within):
        if isinstance(node, ast.Attribute) and _dotted(node.value) == bound:
            used.add(node.attr)
            owners.add(id(node.value))
    alone = any(isinstance(node, ast.Name) and node.id == bound and id(node) not in owners for node in ast.walk(within))
    return used | ({""} if alone else set())


def _dotted(node: ast.expr) -> str | None:
    if isinstance(node, ast.Attribute):
        owner = _dotted(node.value)
        return None if owner is None else f"{owner}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else None


def _row_of(statement: ast.stmt, key: str) -> ast.stmt:
    """Reduce dictionaries in a statement that have the key to the row of that key."""
    reduced = copy.deepcopy(statement)
    for node in ast.walk(reduced):
        if isinstance(node, ast.Dict):
            places = [n for n, name in enumerate(node.keys) if isinstance(name, ast.Constant) and name.value == key]
            if places:
                node.keys, node.values = [node.keys[n] for n in places], [node.values[n] for n in places]
    return reduced
