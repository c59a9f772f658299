"""Many pairs: read their table, register one after another, keep a summary."""
