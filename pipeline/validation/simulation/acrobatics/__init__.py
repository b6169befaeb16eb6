"""Acrobatics of simulated people: lying, crawling, cartwheels, handstands, kneeling, pull-ups, rolls, grappling."""
