"""Parts of the command ``celnav`` beyond the solver: tags of photographs, camera files, pointing, printing and drawing.

No solver imports this package, so it can change without affecting the behaviour of any solver.
"""
