"""Reconstruction: from the files of a capture session to skeletons and result files. Knows no service.

Rooms, each of which imports only from rooms below: ``run``, ``export``, ``association``, ``detection``, ``capture``,
``calibration``, ``motion``, ``video``, ``geometry``, ``core``. ``validation`` is for benchmarks and tests.
"""
