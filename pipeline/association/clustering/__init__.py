"""Association method ``clustering``: 3D hypothesis clustering (Li, Zhou and Liu, Computational Visual Media 2020)."""
