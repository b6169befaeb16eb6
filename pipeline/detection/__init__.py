"""From pictures to 2D joints: networks, their installation and execution, decoders, detection of single bodies.

Imports ``capture`` and what is below.
"""
