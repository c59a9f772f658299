"""Starts of the matching: the georeferencing, a shift or pose that a search finds, or a user's matcher."""
