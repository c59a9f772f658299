"""The bands of a sensor, compared with each other."""
