"""Tie points in pixels of the original files, with readers and writers of all their file formats."""
