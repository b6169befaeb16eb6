"""Simulated captures, and scores against ground truth, for benchmarks and tests.

Imports from every room; only the command line imports it.
"""
