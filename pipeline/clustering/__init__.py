"""3D hypothesis clustering (Chen et al., Computational Visual Media 2020): people from joints, bottom up."""
