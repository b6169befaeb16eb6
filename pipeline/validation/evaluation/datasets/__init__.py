"""Data sets with ground truth: readers and scores of the Shelf benchmark and of rendered captures."""
