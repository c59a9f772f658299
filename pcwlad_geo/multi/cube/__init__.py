"""Cubes of xarray, with an image for each date: aligned by the adjustment of a stack."""
