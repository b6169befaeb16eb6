"""Accuracy of feet and hands against the truth."""
