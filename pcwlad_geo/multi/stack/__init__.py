"""Images of one ground, adjusted together."""
