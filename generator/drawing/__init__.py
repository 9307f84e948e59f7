"""Drawing with Matplotlib: the house style, its colours by day and by night, and lean SVG."""
