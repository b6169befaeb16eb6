"""Evaluation against ground truth: metrics, data sets, baselines and ablations of the papers."""
