"""Stacks of bands: measure every pair, close the triangles, judge, and write the quality report."""
