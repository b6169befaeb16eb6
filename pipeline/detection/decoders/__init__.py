"""Decoders of network outputs to bodies, or to peaks and part affinity fields."""
