"""Data sets with ground truth: loaders and their ways of scoring."""
