"""Benchmarks: speed and memory, one module each."""
