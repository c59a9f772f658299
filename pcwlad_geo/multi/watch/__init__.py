"""Registrations over time: the images of a stack, and the figures of many reports."""
