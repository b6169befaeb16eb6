"""Checks of a calibration alone, without people: ``check_cameras`` is the whole way."""
