"""How the files of a landscape package are compressed, looked at before anything is unpacked.

Python decompresses bzip2 and LZMA without a limit: of a package of a kilobyte one read takes gigabytes, whatever it asks for.
Stellarium's own packages are stored or deflated.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

from generator.ground.stellarium.package import PackageError

_PERMITTED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_NAMES = {zipfile.ZIP_BZIP2: "bzip2", zipfile.ZIP_LZMA: "LZMA", 93: "Zstandard", 95: "xz"}


def check_compression(path: Path, name: str) -> None:
    """Refuse a package with a file that is neither stored nor deflated.

    Parameters
    ----------
    path : Path
    name : str
        Name for messages.

    Raises
    ------
    PackageError
        A file is compressed otherwise. A file that is no zip archive passes, since `Package` names what is wrong with it.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return
    for member in members:
        if member.compress_type not in _PERMITTED:
            kind = _NAMES.get(member.compress_type, f"method {member.compress_type}")
            raise PackageError(
                f"'{name}': '{member.filename[:100]}' is compressed by {kind}, which is not read; pack it again, deflated "
                "(zip -r)"
            )
