"""Records that pass between stages: cameras, detections, tracks, motions and the reconstruction.

All records are frozen, and their arrays are read-only by convention (``read_only``). NaN marks a joint without a
value; its score is 0. World coordinates are metres, right-handed, Z up. Pixel (0, 0) is the centre of the first pixel.
"""
