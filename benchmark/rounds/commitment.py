"""The commitment that is published before a round's frames are drawn; it binds secret, rules and contestants."""

from __future__ import annotations

import dataclasses
import hashlib
import hmac
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from benchmark.errors import RoundError
from benchmark.rounds.rules import Rules, parse_rules
from benchmark.rounds.secret import RoundKey
from benchmark.wrong_key import wrong_key
from generator.errors import GeneratorError
from generator.files import read_at_most, read_text_at_most, write_bytes
from generator.reading.json_text import strict_json

FORMAT = "skybench-round/1"
COMMITMENT, RULES, PACKED, OPENED = "commitment.json", "rules.yaml", "packed.json", "opened.json"
LARGEST_FILE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Terms:
    """What a commitment binds besides the secret.

    Attributes
    ----------
    name : str
        Name of the round.
    frames : int
        Number of frames that are drawn.
    date_utc : str
        Time of the commitment.
    rules_sha256 : str
        Hash of the rules' text.
    skybench, generator_revision : str
        Version and revision that are to render the frames.
    contestants : mapping of str to str
        Revision of each solver, by name, when the round was committed to; for an entrant who submits answers, what he
        supplied.
    beacon : str
        Description of the public random value, still unknown, that will enter the draw; empty if there is none.
    """

    name: str
    frames: int
    date_utc: str
    rules_sha256: str
    skybench: str
    generator_revision: str
    contestants: Mapping[str, str]
    beacon: str


@dataclass(frozen=True)
class Commitment:
    """Terms, and the hash that binds them to the secret.

    Attributes
    ----------
    terms : Terms
    sha256 : str
        See `commitment_sha256`.
    """

    terms: Terms
    sha256: str

    @property
    def label(self) -> str:
        """Name of the round's frames in results."""
        return f"{self.terms.name}@{self.sha256[:12]}"


_READER = TypeAdapter(Terms)


def commitment_sha256(secret: bytes, terms: Terms) -> str:
    """SHA-256 of the format's name, the secret (128 random bits, which need no salt) and the terms as canonical JSON."""
    text = json.dumps(dataclasses.asdict(terms), sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(f"{FORMAT}:{secret.hex()}:{text}".encode("ascii")).hexdigest()


def write_commitment(folder: Path, secret: bytes, terms: Terms, rules: Rules) -> Commitment:
    """Write the rules and the commitment into a new folder.

    Raises
    ------
    RoundError
        A commitment exists already, or the folder cannot be written.
    """
    if (folder / COMMITMENT).exists():
        raise RoundError(f"{folder / COMMITMENT}: there is a commitment already, which must not change; choose another")
    found = Commitment(terms, commitment_sha256(secret, terms))
    content = {"format": FORMAT, "commitment_sha256": found.sha256, **dataclasses.asdict(terms)}
    try:
        write_bytes(folder / RULES, rules.text.encode())
        write_bytes(folder / COMMITMENT, json_bytes(content))
    except OSError as error:
        raise RoundError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from error
    return found


def read_commitment(folder: Path) -> tuple[Commitment, Rules]:
    """Read a round's commitment and the rules next to it.

    Raises
    ------
    RoundError
        One is missing or damaged, or the rules are not those of the commitment.
    """
    path = folder / COMMITMENT
    tree = read_json(path)
    if tree.pop("format", None) != FORMAT:
        raise RoundError(f"{path}: is not of the format {FORMAT}")
    digest = tree.pop("commitment_sha256", None)
    try:
        terms = _READER.validate_python(tree)
    except ValidationError as error:
        raise RoundError(f"{path}: {wrong_key(error)}") from error
    if not isinstance(digest, str):
        raise RoundError(f"{path}: commitment_sha256 is missing")
    place = folder / RULES
    try:
        text = read_text_at_most(place, LARGEST_FILE_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        raise RoundError(f"{place}: the rules cannot be read ({error}); restore them") from error
    if hashlib.sha256(text.encode()).hexdigest() != terms.rules_sha256:
        raise RoundError(f"{place}: are not the rules of {path} (another SHA-256); restore them")
    return Commitment(terms, digest), parse_rules(text, str(place))


def check_secret(found: Commitment, secret: bytes) -> None:
    """Check that secret and terms are those of the commitment. Raises RoundError."""
    if not hmac.compare_digest(commitment_sha256(secret, found.terms), found.sha256):
        raise RoundError(
            f"round {found.terms.name}: secret and terms do not give the commitment {found.sha256[:12]}…: "
            "one of them was changed after it was published"
        )


def key_of(found: Commitment, secret: bytes, beacon: str) -> RoundKey:
    """Key that draws the round's frames. Raises RoundError where the beacon's value is missing or not expected."""
    if bool(beacon) != bool(found.terms.beacon):
        wanted = f"the value of {found.terms.beacon} with --beacon" if found.terms.beacon else "no --beacon"
        raise RoundError(f"round {found.terms.name}: give {wanted}, as it was committed")
    return RoundKey.of(secret, found.terms.rules_sha256, beacon)


def json_bytes(content: Mapping[str, Any]) -> bytes:
    """Serialise the content of a published file."""
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def read_json(path: Path) -> dict[str, Any]:
    """Read a published file. Raises RoundError where it is missing, too large or not a JSON object."""
    try:
        return dict(strict_json(read_at_most(path, LARGEST_FILE_BYTES), str(path), LARGEST_FILE_BYTES))
    except OSError as error:
        raise RoundError(f"{path}: cannot be read ({error.strerror}); see `skybench bench round draw`") from error
    except (GeneratorError, ValueError, TypeError) as error:
        raise RoundError(f"{path}: is no JSON object ({error})") from error
