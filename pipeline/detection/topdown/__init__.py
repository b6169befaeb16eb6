"""Landmarks in crops of bodies and hands: refined joints, heels, toes and fingers (docs/lab/detection.md)."""
