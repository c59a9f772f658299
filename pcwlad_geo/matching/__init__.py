"""Arrays to tie points: no file, no CRS in here."""
