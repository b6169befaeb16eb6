"""Calibrations: sent as files, or made from a board or from people."""
