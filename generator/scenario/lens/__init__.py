"""Numbers and keys of a lens beside its projection."""
