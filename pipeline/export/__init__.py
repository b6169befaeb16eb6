"""From people to files and figures: writers, viewer, Rerun files, report, OpenSim, characters, privacy, quality.

Imports ``association`` and what is below.
"""
