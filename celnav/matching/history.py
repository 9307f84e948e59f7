"""Optional memory of a solver from frame to frame."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass
class History:
    """Catalogue choices of successful matches, oldest first (the thesis, section 4.iv.3).

    The caller makes a history, passes it to `celnav.solve` with every frame, and discards it at the end; the solver appends
    to it. Nothing else in celnav keeps state between frames.

    Attributes
    ----------
    length : int
        Number of successful matches that are kept.
    entries : list of (int, float)
        Magnitude limit of the catalogue in tenths of a magnitude, and similarity.
    """

    length: int = 20
    entries: list[tuple[int, float]] = field(default_factory=list)

    def record(self, limit_decimag: int, similarity: float) -> None:
        """Add a successful match, and drop the oldest ones beyond `length`."""
        self.entries.append((limit_decimag, similarity))
        del self.entries[: -self.length]

    def consensus(self, min_matches: int, min_similarity: float) -> tuple[int, float] | None:
        """Return the magnitude limit chosen most often (in tenths) and its share among the good matches, or None.

        Parameters
        ----------
        min_matches : int
            Least number of good matches for a consensus.
        min_similarity : float
            Least similarity of a good match.
        """
        good = [limit for limit, similarity in self.entries if similarity >= min_similarity]
        if len(good) < min_matches:
            return None
        # Ties go to the brighter limit, so that the answer does not depend on the order of insertion.
        limit, count = min(Counter(good).items(), key=lambda item: (-item[1], item[0]))
        return limit, count / len(good)
