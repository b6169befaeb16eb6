"""Benchmarks of speed and memory, a module for each subcommand of `multicap benchmark`."""
