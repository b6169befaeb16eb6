"""Association method ``clustering``: 3D hypothesis clustering (Chen et al., Computational Visual Media 2020)."""
