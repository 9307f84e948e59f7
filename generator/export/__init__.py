"""Export of a dataset to the formats of other programs (docs/exports.md)."""
