"""Fuzzing and chaos: damaged inputs for the real command line. See docs/development/fuzzing.md."""
