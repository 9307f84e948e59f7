"""Hills of an elevation raster: its file, its map projection, and the view from one place."""
