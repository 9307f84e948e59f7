"""The secret of a round, and the random numbers derived from it.

Everything that a round draws comes from keys of HMAC-SHA-256 (RFC 2104), one for each purpose and frame. Whoever recovers the
numbers of one draw therefore learns nothing about another; NumPy's ``SeedSequence`` alone does not guarantee this, as its
mixing can be inverted. Each key is the entropy, 256 bits, of its own ``SeedSequence``.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.errors import RoundError

SECRET_BYTES = 16
LARGEST_SECRET_FILE = 1000
_DIGITS = re.compile(r"[0-9a-f]{32}")


@dataclass(frozen=True)
class RoundKey:
    """Source of all random numbers of a round.

    Attributes
    ----------
    key : bytes
    """

    key: bytes

    @classmethod
    def of(cls, secret: bytes, rules_sha256: str, beacon: str) -> RoundKey:
        """Derive the key from the secret, the rules and a public random value published after both (empty without one)."""
        words = f"skybench-round/1:{rules_sha256}:{beacon}".encode()
        return cls(hmac.new(secret, words, hashlib.sha256).digest())

    def digest(self, purpose: str, index: int) -> bytes:
        """Derive 32 bytes for one purpose and frame."""
        return hmac.new(self.key, f"{purpose}:{index}".encode(), hashlib.sha256).digest()

    def stream(self, purpose: str, index: int) -> np.random.Generator:
        """Generator of random numbers for one purpose and frame, independent of all others."""
        entropy = int.from_bytes(self.digest(purpose, index), "big")
        return np.random.Generator(np.random.PCG64DXSM(np.random.SeedSequence(entropy)))


def new_secret(path: Path) -> bytes:
    """Draw a secret of 128 bits from the operating system and write it to a new file that only its owner can read.

    Raises
    ------
    RoundError
        The file exists, or cannot be written.
    """
    secret = secrets.token_bytes(SECRET_BYTES)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise RoundError(
            f"{path}: the file exists, and a secret draws the same frames again under the same rules; choose a new file, "
            "or delete it if no commitment was made with it"
        ) from error
    except OSError as error:
        raise RoundError(f"{path}: the secret cannot be written ({error.strerror}); choose a new file") from error
    with os.fdopen(handle, "w", encoding="ascii") as stream:
        stream.write(secret.hex() + "\n")
    return secret


@contextmanager
def secret_for(commitment: Path, path: Path) -> Iterator[bytes]:
    """A new secret, for a commitment that is made meanwhile; without one the secret's file does not stay.

    Parameters
    ----------
    commitment : Path
        File of the commitment, which does not exist yet.
    path : Path
        File of the secret, which does not exist yet.

    Raises
    ------
    RoundError
        As for `new_secret`.
    """
    secret, had_one = new_secret(path), commitment.exists()
    try:
        yield secret
    except BaseException:
        # A commitment that was written before an interruption needs its secret.
        if had_one or not commitment.exists():
            path.unlink(missing_ok=True)
        raise


def read_secret(path: Path) -> bytes:
    """Read a secret: 32 hexadecimal digits, which is 128 bits.

    Raises
    ------
    RoundError
        It is missing or has another length; its content is not printed.
    """
    try:
        if path.stat().st_size > LARGEST_SECRET_FILE:
            raise RoundError(f"{path}: larger than any secret; expected 32 hexadecimal digits")
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise RoundError(
            f"{path}: the secret cannot be read ({error}); `skybench bench round draw` makes one"
        ) from error
    if not _DIGITS.fullmatch(text):
        raise RoundError(
            f"{path}: found {len(text)} characters, expected 32 hexadecimal digits (128 bits): a shorter "
            "secret can be found by trying; `skybench bench round draw` makes one"
        )
    if len(set(text)) < 4:
        raise RoundError(
            f"{path}: {len(set(text))} different digits are no random secret; let `skybench bench round draw` make one"
        )
    return bytes.fromhex(text)
