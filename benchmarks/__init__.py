"""Accuracy figures of the package on real and synthetic pairs: figures, not tests. See README.md."""
