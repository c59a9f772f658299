"""Products of several files, Landsat and Sentinel-2, recognised by their file names and metadata."""
