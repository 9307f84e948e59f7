"""Datasets: many frames of a scenario in shards, with tables, a manifest and a card (docs/dataset_format.md)."""
