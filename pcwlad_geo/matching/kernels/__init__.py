"""Compiled inner loops; `tests/oracles` has plain versions of them."""
