"""Cross-view tracking as compiled loops."""
