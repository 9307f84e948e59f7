"""Shared by the studies: contestants, records, pages."""
