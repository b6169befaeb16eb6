"""Association method ``tracking``: cross-view tracking (Chen et al., CVPR 2020)."""
