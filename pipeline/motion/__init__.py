"""Motion of one body: skeleton fit, feet and hands, the body's mesh, joint angles, gait.

Imports ``video``, ``geometry`` and ``core``.
"""
