"""The parts of `benchmarks/speed.py`: scenes, measurements, and one module a study."""
