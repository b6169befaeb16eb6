"""From people to files and figures: writers, viewer, recording, report, OpenSim, characters, privacy, quality.

Imports ``association`` and what is below.
"""
