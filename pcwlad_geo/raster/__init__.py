"""Raster files: opening, bands, grids, CRSs, validity masks, windows, warping and output formats."""
