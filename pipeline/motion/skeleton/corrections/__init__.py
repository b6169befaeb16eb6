"""Corrections of joints by hand: evidence, contacts, and a fit of the frames around them."""
