"""The objects of the Python interface, which compose: tie points, corrections, registrations."""
