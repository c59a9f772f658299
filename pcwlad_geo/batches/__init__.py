"""Batches of pairs: reading of their table, registration one after another, summary."""
