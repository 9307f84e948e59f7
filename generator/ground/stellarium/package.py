"""A landscape package from a third party: an archive of limited size, and its landscape.ini as checked values.

Nothing is unpacked to disk. A member is used only if it is in the folder of landscape.ini or below it, and is read up to
a limit, whatever its header states. All members must be stored or deflated, as in Stellarium's own packages: Python
decompresses bzip2 and LZMA without a limit, and one read of a package of a kilobyte takes gigabytes, whatever it asks for.
"""

from __future__ import annotations

import io
import lzma
import math
import posixpath
import re
import struct
import zipfile
import zlib
from pathlib import Path

INI = "landscape.ini"
MOST_MEMBERS = 2000
"""Limit of the number of members; packages have some tens, with descriptions in many languages."""
LARGEST_DIRECTORY_BYTES = 1000 * MOST_MEMBERS
"""Limit of the list of members at the end of the archive, in which a member takes 46 bytes, its name and some attributes."""
LARGEST_INI_BYTES = 65_536
LARGEST_LIST_BYTES = 2_000_000
LARGEST_MEMBER_BYTES = 200_000_000
LONGEST_VALUE = 1000
_PERMITTED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_METHODS = {zipfile.ZIP_BZIP2: "bzip2", zipfile.ZIP_LZMA: "LZMA", 93: "Zstandard", 95: "xz"}
_SECTION = re.compile(r"\[(.+)\]")
_ENTRY = re.compile(r"([^=]+)=(.+)")


class PackageError(ValueError):
    """The package cannot be used; the message names the file, the key and what is expected."""


class _TooLongError(Exception):
    """The list of members is longer than LARGEST_DIRECTORY_BYTES."""


class _Listing(io.BufferedReader):
    """An archive of which only a short list of members is read.

    Python reads the list as one piece, makes objects of all its entries, whatever number of them is stated, and counts none.
    """

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > LARGEST_DIRECTORY_BYTES:
            raise _TooLongError
        return super().read(size)


class Package:
    """An open package.

    Parameters
    ----------
    path : Path
    name : str
        Name for messages.

    Raises
    ------
    PackageError
        The file is not a zip archive, has too many files or one that is neither stored nor deflated, or does not have
        exactly one landscape.ini.
    """

    def __init__(self, path: Path, name: str) -> None:
        self.name = name
        try:
            with _Listing(io.FileIO(path)) as stream, zipfile.ZipFile(stream):
                pass
            self.archive = zipfile.ZipFile(path)
            entries = self.archive.infolist()
        except _TooLongError:
            raise PackageError(
                f"'{name}' has a list of files of more than {LARGEST_DIRECTORY_BYTES} bytes; a landscape has at most "
                f"{MOST_MEMBERS} files: pack one landscape's folder"
            ) from None
        except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError, struct.error) as error:
            raise PackageError(f"'{name}' is not a zip archive ({error})") from error
        # Before Python 3.12, a member without a name cannot even be asked whether it is a folder.
        if not all(info.filename for info in entries):
            raise PackageError(f"'{name}' has a file without a name, so it is damaged: pack it again")
        members = [info for info in entries if not info.is_dir()]
        if len(members) > MOST_MEMBERS:
            raise PackageError(f"'{name}' has {len(members)} files; a landscape has at most {MOST_MEMBERS}")
        for member in members:
            self._check_compression(member)
        self.members = {info.filename: info for info in members}
        found = [place for place in self.members if posixpath.basename(place) == INI and "__MACOSX" not in place]
        if len(found) != 1:
            raise PackageError(f"'{name}' has {len(found)} files {INI}, expected one: pack one landscape's folder")
        self.folder = posixpath.dirname(found[0])
        self.values = self._ini(found[0])

    def _check_compression(self, member: zipfile.ZipInfo) -> None:
        if member.compress_type not in _PERMITTED:
            kind = _METHODS.get(member.compress_type, f"method {member.compress_type}")
            raise PackageError(
                f"'{self.name}': '{member.filename[:100]}' is compressed by {kind}, which is not read; pack it again, "
                "deflated (zip -r)"
            )

    def _ini(self, place: str) -> dict[str, str]:
        """The section [landscape], keys in lower case."""
        data = self._bytes(place, LARGEST_INI_BYTES)
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        if "\x00" in text:
            raise PackageError(f"'{self.name}': {INI} is not a text in UTF-8 or Latin-1; save it as UTF-8")
        values = landscape_section(text)
        if values is None:
            raise PackageError(f"'{self.name}': {INI} has no section [landscape]")
        for key, value in values.items():
            if len(value) > LONGEST_VALUE and key not in ("description", "author"):
                raise PackageError(f"'{self.name}': {INI}: {key} has {len(value)} characters, at most {LONGEST_VALUE}")
        return values

    def _bytes(self, place: str, most: int) -> bytes:
        try:
            with self.archive.open(self.members[place]) as stream:
                data = stream.read(most + 1)
        except (
            OSError,
            RuntimeError,
            NotImplementedError,
            zipfile.BadZipFile,
            zlib.error,
            lzma.LZMAError,
            EOFError,
            ValueError,
        ) as error:
            reason = str(error)[:200] or type(error).__name__
            raise PackageError(f"'{self.name}': '{place}' cannot be unpacked ({reason}); pack it again") from error
        if len(data) > most:
            raise PackageError(f"'{self.name}': '{place}' has more than {most} bytes; make it smaller")
        return data

    def file(self, key: str, most: int = LARGEST_MEMBER_BYTES) -> bytes:
        """Contents of the file that a key names. Raises PackageError."""
        named = self.text(key)
        place = posixpath.normpath(posixpath.join(self.folder, named.replace("\\", "/")))
        inside = not self.folder or place.startswith(f"{self.folder}/")
        if place.startswith(("/", "..")) or not inside:
            raise PackageError(f"'{self.name}': {INI}: {key} = {named} leaves the package")
        if place not in self.members:
            raise PackageError(f"'{self.name}': {INI}: {key} = {named}: there is no such file in the package; add it")
        return self._bytes(place, most)

    def has(self, key: str) -> bool:
        """Whether a key has a value."""
        return bool(self.values.get(key))

    def text(self, key: str, default: str | None = None) -> str:
        """A key's value. Raises PackageError if it is missing and has no default."""
        value = self.values.get(key) or default
        if value is None:
            raise PackageError(f"'{self.name}': {INI}: {key} is missing; add it to [landscape]")
        return value

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """A number between limits. Raises PackageError."""
        return self.parsed(key, self.text(key, repr(default)), low, high)

    def parsed(self, key: str, text: str, low: float, high: float) -> float:
        """A number between limits that is part of a key's value. Raises PackageError."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise PackageError(
                f"'{self.name}': {INI}: {key}: found {text!r}, expected a number from {low:g} to {high:g}"
            )
        return value

    def count(self, key: str, default: int, most: int) -> int:
        """A whole number from 1. Raises PackageError."""
        value = self.number(key, default, 1, most)
        if value != int(value):
            raise PackageError(f"'{self.name}': {INI}: {key}: found {value:g}, expected a whole number")
        return int(value)

    def flag(self, key: str) -> bool:
        """Whether a switch is on; off if it is missing."""
        return self.text(key, "false").lower() in ("true", "1", "yes", "on")

    def colour(self, key: str, default: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        """Three numbers from 0 to 1; the default if the key is missing or its red is negative. Raises PackageError."""
        if not self.has(key):
            return default
        parts = self.text(key).replace(",", " ").split()
        if len(parts) != 3:
            raise PackageError(f"'{self.name}': {INI}: {key}: found {self.text(key)!r}, expected three numbers")
        red, green, blue = (self.parsed(key, part, -1, 1) for part in parts)
        return default if min(red, green, blue) < 0 else (red, green, blue)


def landscape_section(text: str) -> dict[str, str] | None:
    """Values of the section [landscape] of a landscape.ini, keys in lower case; None if there is no such section.

    As in Stellarium (`StelIniParser.cpp`, `readStelIniFile`), every line stands for itself whatever its indentation, # and ;
    start a comment anywhere in a line, and of a repeated key the last value counts.
    """
    values, section, found = {}, "", False
    for line in re.split(r"[\r\n]+", text):
        line = re.split("[#;]", line, maxsplit=1)[0].strip()
        if head := _SECTION.fullmatch(line):
            section = head[1].strip().lower()
            found = found or section == "landscape"
        elif section == "landscape" and (entry := _ENTRY.fullmatch(line)):
            values[entry[1].strip().lower()] = entry[2].strip().strip('"').strip()
    return values if found else None
