"""Running solvers over frames and keeping their results."""

import generator as generator  # before NumPy: it settles the processor's instructions, on which bytes of frames depend
