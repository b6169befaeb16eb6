"""Outputs of detector networks to bodies, or to part affinity fields."""
