"""Hills of an elevation raster: its file, its map projection, and what of it is seen from one place."""
