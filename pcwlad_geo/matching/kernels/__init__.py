"""Compiled inner loops (`kernels/`, in C) as functions of arrays; `tests/oracles` has plain versions."""
