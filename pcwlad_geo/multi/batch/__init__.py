"""Pairs of a table, registered one after another."""
