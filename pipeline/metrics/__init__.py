"""Quality without ground truth, and accuracy against it."""
