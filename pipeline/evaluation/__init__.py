"""Accuracy against ground truth: metrics, data sets and the papers' comparisons."""
