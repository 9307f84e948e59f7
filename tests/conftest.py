"""Before any test loads NumPy: the instructions that it computes with, as in the commands."""

import generator as generator
