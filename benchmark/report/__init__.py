"""Presentation of results: terminal tables, pages and figures."""
