"""A star identification by a network that was trained here."""
