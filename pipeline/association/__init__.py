"""From 2D bodies of all cameras to people in 3D: tracking, clustering, identity, second detection, hands.

Imports ``detection``, ``capture``, ``motion`` and what is below; ``tracking`` and ``clustering`` only records and
geometry.
"""
