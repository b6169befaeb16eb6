"""The stages of a reconstruction: planned, run, and executed on one machine."""
