"""Properties of a lens other than its projection."""
