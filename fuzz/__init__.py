"""Fuzzing, chaos and what they share: damaged inputs for the real command line. See docs/fuzzing.md."""
