"""Choices of a reconstruction: their vocabulary, values, rules, and edits of people. Knows no science."""
