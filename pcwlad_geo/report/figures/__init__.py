"""Figures of the report: arrays in, PNG out."""
