"""Hands of people: fingers follow the bodies that association has found, where two views agree."""
