"""Files: bands, grids, CRS, validity, windows, warping, tie-point formats."""
