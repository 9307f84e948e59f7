"""Before any test loads NumPy: the instructions that it computes with, as in the commands. Then what all tests share."""

import generator as generator

from hypothesis import settings  # isort: skip

settings.register_profile("skybench", deadline=None)  # tests assert results, not times
settings.load_profile("skybench")
