"""From files to a capture session: videos, keypoint files, pictures of cameras, clocks.

Imports ``calibration``, ``motion``, ``video``, ``geometry`` and ``core``.
"""
