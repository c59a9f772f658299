"""From tie points to corrections: models, fits, model choice, check points, accuracy; arrays only."""
