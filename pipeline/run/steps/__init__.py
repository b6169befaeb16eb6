"""Stages of jobs, one module each, which declares the stage above its function.

A module's head imports ``run.engine.stage`` alone; its function imports the science when it runs.
"""
