"""`multicap benchmark plan`: what a cluster needs for so many hours of cameras a day, and how long jobs wait."""
