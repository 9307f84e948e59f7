"""Memory from frame to frame, for callers who want their solver to have one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class History:
    """Catalogue choices of successful matches, oldest first (the thesis, section 4.iv.3).

    The caller makes one, passes it to `celnav.solve` frame after frame, and throws it away; nothing else in celnav
    remembers anything. The solver appends to it.

    Attributes
    ----------
    length : int
        How many successful matches are kept.
    entries : list of (int, float)
        Magnitude limit of the catalogue in tenths of a magnitude, and similarity.
    """

    length: int = 20
    entries: list[tuple[int, float]] = field(default_factory=list)

    def record(self, limit_decimag: int, similarity: float) -> None:
        """Add a successful match, forgetting the oldest beyond `length`."""
        self.entries.append((limit_decimag, similarity))
        del self.entries[: -self.length]

    def consensus(self, min_matches: int, min_similarity: float) -> tuple[int, float] | None:
        """Return the magnitude limit chosen most often (in tenths) and its share among the good matches.

        Parameters
        ----------
        min_matches : int
            Fewer good matches than this make no consensus.
        min_similarity : float
            A match is good from this similarity on.
        """
        good = [limit for limit, similarity in self.entries if similarity >= min_similarity]
        if len(good) < min_matches:
            return None
        # Among equals the brighter limit, so that the answer does not depend on the order of insertion.
        limit, count = min(Counter(good).items(), key=lambda item: (-item[1], item[0]))
        return limit, count / len(good)
