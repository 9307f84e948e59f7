"""The revision of the generator's behaviour, on which a scenario's frames depend in addition to the scenario.

It covers the syntax trees of all modules that rendering imports (`generator.identity.behaviour`) and the data files that
come with them. Comments, docstrings and formatting do not count. Versions of Mitsuba, Dr.Jit and NumPy do not either,
because every frame record states them, and results contain the hashes of the frames themselves.

Parsing takes about a second. The result is therefore cached in the user's cache folder under a hash of the files' bytes,
which takes some hundredths of a second; nothing is imported for it.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

import platformdirs

from generator.files import write_bytes
from generator.identity.behaviour import Entry, Sources, behaviour_of

ENTRY = "generator.frame.render"
"""Starting point of the code that renders a frame."""
REVISION_DIGITS = 16
GENERATOR_REVISION = "generator_revision"
"""Key of the revision in the provenance of a frame record."""
_PACKAGE = Path(__file__).parents[1]
_REVISION = re.compile(r"[0-9a-f]{16}")


@functools.cache
def generator_revision() -> str:
    """Revision of the installed generator, determined once per process."""
    texts = {path.relative_to(_PACKAGE.parent).as_posix(): path.read_bytes() for path in sorted(_PACKAGE.rglob("*.py"))}
    data = {path.relative_to(_PACKAGE.parent).as_posix(): path for path in sorted((_PACKAGE / "data").rglob("*"))}
    data_digest = files_digest({name: path.read_bytes() for name, path in data.items() if path.is_file()})
    kept = platformdirs.user_cache_path("skybench") / f"revision-{files_digest(texts)[:16]}-{data_digest[:16]}"
    try:
        known = kept.read_text(encoding="ascii")
    except (OSError, ValueError):
        known = ""
    if _REVISION.fullmatch(known):
        return known
    revision = revision_of(sources_of(texts), data_digest)
    try:
        write_bytes(kept, revision.encode("ascii"))
    except OSError:
        return revision  # an unwritable folder only costs the time
    return revision


def sources_of(files: Mapping[str, bytes]) -> Sources:
    """Modules among Python files by their paths, such as ``generator/frame/render.py``; other programs are left out."""
    parts = {name: name.removesuffix(".py").split("/") for name in files}
    modules = {name: text.decode("utf-8") for name, text in files.items() if all(map(str.isidentifier, parts[name]))}
    return Sources.of_files(modules)


def revision_of(sources: Sources, data_digest: str) -> str:
    """Revision of a generator with these sources and the digest of its data files; hexadecimal digits."""
    code = behaviour_of(sources, Entry([(ENTRY, "")])).digest
    return hashlib.sha256(f"{code}:{data_digest}".encode()).hexdigest()[:REVISION_DIGITS]


def files_digest(files: Mapping[str, bytes]) -> str:
    """SHA-256 of files, their names and contents, in hexadecimal digits."""
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}:{hashlib.sha256(files[name]).hexdigest()};".encode())
    return digest.hexdigest()
