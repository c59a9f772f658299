"""The joint adjustment of the RPCs of many images over a DEM."""
