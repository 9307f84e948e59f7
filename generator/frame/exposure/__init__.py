"""Expected light of an exposure: at once, or as the sum of parts."""
