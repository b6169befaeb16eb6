"""Properties of a video that its file states: packets, pixels, regularity of its times, clocks."""
