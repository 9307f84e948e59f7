"""Physically based synthetic night-sky frames, with complete truth.

A scenario file and a frame index give an image, the expected electrons behind it, a frame record and a table of every
star in the field. The stages are: catalogue, apparent places, atmosphere, Mitsuba scene, expected electrons, detector.
"""

from importlib.metadata import version

from generator.instruction_set import settle

settle()

__version__ = version("skybench")
