"""Camera rigs: several lenses that look the same way, learned from captures and brought onto each other."""
