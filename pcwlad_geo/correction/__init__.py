"""Tie points to corrections: models, fits, model choice, check points, accuracy. Arrays only."""
