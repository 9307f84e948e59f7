"""Landscape packages of Stellarium: a zip archive with a landscape.ini, its pictures and its horizon lists."""
