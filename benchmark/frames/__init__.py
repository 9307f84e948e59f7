"""Frames for solvers and truth for the judge, read from rendered folders, datasets and tasks."""
