"""Checks of a calibration alone, without people. Entry point: ``check_cameras``."""
