"""A dataset in the forms that other programs read (docs/exports.md)."""
