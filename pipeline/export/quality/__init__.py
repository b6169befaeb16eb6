"""Quality of a reconstruction without ground truth."""
