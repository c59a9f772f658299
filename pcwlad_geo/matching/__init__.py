"""From arrays to tie points, without files and CRS."""
