"""Frames for solvers and truth for the judge, read from rendered folders, datasets and tasks."""

import generator as generator  # before NumPy: it settles the processor's instructions, on which bytes of frames depend
