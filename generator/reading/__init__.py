"""Readers of files from other parties: JSON, frame records, tables and images, each within stated limits."""
