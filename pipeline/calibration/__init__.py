"""From files, boards, people or known points to calibrated cameras, and checks of calibrations.

Imports ``motion``, ``video``, ``geometry`` and ``core``.
"""
