"""The benchmark runs solvers over graded night skies, judges their answers, compares them and reports the results."""

import generator as generator  # before NumPy: it settles the processor's instructions, on which bytes of frames depend
