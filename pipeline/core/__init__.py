"""Parts that all rooms share: records, options, joints, errors, problem codes, child processes.

Imports no other room.
"""
