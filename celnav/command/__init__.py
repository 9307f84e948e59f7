"""What the command ``celnav`` needs beyond a solver: photographs' tags, camera files, pointing, printing and drawing.

No solver imports this room: it may change without touching the behaviour of one.
"""
